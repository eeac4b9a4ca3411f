from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.grid import GrowingLattice, SlidingLattice, Window
from quadlog.mapping.memory import LogOddsMemory
from quadlog.mapping.placing import NO_TOP, PlacedScan
from quadlog.mapping.ray_tracing import NO_RAY

WINDOW = Window(0, 0, 0.1, (10, 12))
STEP_NS = 100_000_000


def tops(*cells: tuple[int, int], top_m: float = 1.0, shape: tuple[int, int] = WINDOW.shape) -> np.ndarray:
    top = np.full(shape, NO_TOP, dtype=np.int16)
    for row, col in cells:
        top[row, col] = round(1000 * top_m)
    return top


def rays(lowest_m: float, shape: tuple[int, int] = WINDOW.shape) -> np.ndarray:
    return np.full(shape, round(1000 * lowest_m), dtype=np.int16)


UNSEEN = np.full(WINDOW.shape, NO_RAY, dtype=np.int16)
SEEN_THROUGH = rays(0.0)


def log_odds(clear_s: float = 0.4) -> LogOddsMemory:
    return LogOddsMemory(SlidingLattice(0.1, LogOddsMemory.LAYERS), clear_s)


@pytest.mark.parametrize("rate_hz", [5, 10, 20])
def test_moving_obstacles_are_cleared_within_half_a_second(rate_hz: int) -> None:
    memory = log_odds()
    step_ns = 10**9 // rate_hz
    for k in range(20):
        assert memory.add(k * step_ns, WINDOW, PlacedScan(tops((5, 5)), SEEN_THROUGH))[5, 5]
    gone = [memory.add((20 + k) * step_ns, WINDOW, PlacedScan(tops(), SEEN_THROUGH))[5, 5] for k in range(rate_hz)]
    assert not any(gone[rate_hz // 2 - 1 :]), "a ghost half a second after the last hit"
    assert any(gone) or rate_hz == 5, "one glance past an obstacle must not clear it"


def test_a_false_point_is_gone_sooner_than_an_obstacle() -> None:
    memory = log_odds()
    for k in range(5):
        memory.add(k * STEP_NS, WINDOW, PlacedScan(tops((2, 2), (7, 7)) if k == 4 else tops((2, 2)), SEEN_THROUGH))
    after = [memory.add((5 + k) * STEP_NS, WINDOW, PlacedScan(tops(), SEEN_THROUGH)) for k in range(4)]
    assert [bool(grid[7, 7]) for grid in after] == [True, False, False, False]
    assert [bool(grid[2, 2]) for grid in after] == [True, True, True, False]


@pytest.mark.parametrize(
    ("ray", "stays"), [(UNSEEN, True), (rays(0.46), True), (rays(0.45), False), (rays(0.29), False)]
)
def test_only_rays_at_its_height_or_below_contradict_an_obstacle(ray: np.ndarray, stays: bool) -> None:
    """A 2-D lidar has none below the plane in which something was hit."""
    memory = log_odds()
    memory.add(0, WINDOW, PlacedScan(tops((5, 5), top_m=0.45), UNSEEN))
    kept = [memory.add(k * STEP_NS, WINDOW, PlacedScan(tops(), ray))[5, 5] for k in range(1, 50)]
    assert kept[2:] == [stays] * 47


@pytest.mark.parametrize(("lattice", "comes_back"), [(SlidingLattice, False), (GrowingLattice, True)])
def test_the_window_slides_and_what_it_leaves_is_dropped_or_kept(lattice, comes_back: bool) -> None:
    memory = LogOddsMemory(lattice(0.1, LogOddsMemory.LAYERS), 100.0)
    near, beside, away = WINDOW, Window(3, -2, 0.1, (10, 12)), Window(50, 0, 0.1, (10, 12))
    memory.add(10**9, near, PlacedScan(tops((5, 5)), UNSEEN))
    assert np.argwhere(memory.add(2 * 10**9, beside, PlacedScan(tops(), UNSEEN))).tolist() == [[7, 2]]
    assert not memory.add(3 * 10**9, away, PlacedScan(tops(), UNSEEN)).any()
    assert bool(memory.add(4 * 10**9, near, PlacedScan(tops(), UNSEEN))[5, 5]) is comes_back


def test_scans_beyond_the_size_limit_are_counted_and_used_alone() -> None:
    memory = LogOddsMemory(GrowingLattice(0.1, LogOddsMemory.LAYERS, most_cells=200), 0.4)
    memory.add(0, WINDOW, PlacedScan(tops((5, 5)), UNSEEN))
    far = Window(5000, 0, 0.1, WINDOW.shape)
    assert np.argwhere(memory.add(STEP_NS, far, PlacedScan(tops((1, 1)), UNSEEN))).tolist() == [[1, 1]]
    assert memory.lattice.skipped == 1


@pytest.mark.parametrize("passes", [1, 2, 10])
def test_a_crate_outlasts_the_person_who_stepped_over_it(passes: int) -> None:
    """It is out of the beams' reach then; they pass half a metre above it, where the person was."""
    memory, step = log_odds(), 0

    def add(top: np.ndarray, ray: np.ndarray) -> bool:
        nonlocal step
        step += 1
        return bool(memory.add(step * STEP_NS, WINDOW, PlacedScan(top, ray))[5, 5])

    for _ in range(5):
        add(tops((5, 5), top_m=0.2), UNSEEN)
    for _ in range(passes):
        add(tops((5, 5), top_m=1.4), UNSEEN)
    assert all(add(tops(), rays(0.7)) for _ in range(50))
    assert not all(add(tops(), rays(0.15)) for _ in range(5)), "what is taken away is forgotten as before"
