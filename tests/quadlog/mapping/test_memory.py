from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binned_statistic_2d

from quadlog.lidar.classified_scan import PointClass
from quadlog.mapping.grid import GrowingLattice, SlidingLattice, Window, window_around
from quadlog.mapping.memory import FREE, OCCUPIED, AccumulatedMap, GroundHeight, LogOddsMemory
from quadlog.mapping.placing import NO_RAY, NO_TOP, PlacedScan

WINDOW = Window(0, 0, 0.1, (10, 12))
STEP_NS = 100_000_000


def tops(*cells: tuple[int, int], top_m: float = 1.0) -> np.ndarray:
    top = np.full(WINDOW.shape, NO_TOP, dtype=np.int16)
    for row, col in cells:
        top[row, col] = round(1000 * top_m)
    return top


def rays(lowest_m: float) -> np.ndarray:
    return np.full(WINDOW.shape, round(1000 * lowest_m), dtype=np.int16)


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


def add(whole: AccumulatedMap, window: Window, hit: np.ndarray, crossed: np.ndarray) -> None:
    top_mm = np.where(hit, np.int16(500), NO_TOP)
    # What is seen through above the robot says nothing.
    whole.add(window, PlacedScan(top_mm, np.where(crossed, np.int16(399), np.where(hit, NO_RAY, np.int16(400)))), 400)


@pytest.mark.parametrize(("hits", "passes", "expected"), [(3, 7, OCCUPIED), (2, 7, FREE), (1, 0, OCCUPIED)])
def test_a_cell_is_occupied_by_its_share_of_hits(hits: int, passes: int, expected: int) -> None:
    window, nothing, there = Window(0, 0, 1.0, (1, 10)), np.zeros((1, 10), bool), np.arange(10)[None] == 4
    whole = AccumulatedMap(1.0)
    # What is hit is not seen through in the same scan.
    for hit, crossed in [(there, there)] * hits + [(nothing, there)] * passes:
        add(whole, window, hit, crossed)
    assert whole.to_cells()[0][0, 4] == expected


def test_sliding_windows_agree_with_one_fixed_array_and_poses_far_off_are_skipped() -> None:
    random, whole, counts = np.random.default_rng(0), AccumulatedMap(0.5), np.zeros((400, 400), np.int64)
    for position in np.cumsum(random.uniform(-3, 5, (40, 2)), axis=0) - 30:
        window, occupied = window_around(position, 0.5, 20), random.random((20, 20)) < 0.1
        add(whole, window, occupied, np.zeros_like(occupied))
        counts[window.row0 + 200 : window.row0 + 220, window.col0 + 200 : window.col0 + 220] += occupied
    for x_m in (1e8, -1e15):
        add(whole, window_around(np.array([x_m, 0.0]), 0.5, 20), occupied, np.zeros_like(occupied))
    cells, held = whole.to_cells()
    rows, cols = held.shape
    inside = counts[held.row0 + 200 : held.row0 + 200 + rows, held.col0 + 200 : held.col0 + 200 + cols]
    assert inside.sum() == counts.sum()
    assert (whole.lattice.view("hits", held) == inside).all()
    assert ((cells == OCCUPIED) == (inside > 0)).all()
    assert whole.lattice.skipped == 2


def test_mean_heights_agree_with_scipy_and_a_scan_beyond_the_limit_is_skipped(scanned) -> None:
    random = np.random.default_rng(0)
    ground, scans = GroundHeight(0.25), [random.uniform(-10, 10, (4000, 2)) for _ in range(4)]
    heights = [random.normal(0, 0.1, 4000) for _ in scans]
    for x_m, xy_m, height_m in zip((0.0, 5.0, 10.0, 15.0), scans, heights, strict=True):
        # One of another class among them.
        xyz_m = np.insert(np.column_stack([xy_m, height_m]), 2000, [[3.0, 3.0, 99.0]], axis=0)
        label = np.insert(np.full(4000, PointClass.GROUND, np.uint8), 2000, PointClass.OBSTACLE)
        ground.add(scanned(xyz_m, label), np.array([[x_m, 0.0, 0.0]]), 20.0)
    ground.add(scanned([[0.1, 0.1, 0.5]], PointClass.GROUND), np.array([[1e9, 0.0, 0.0]]), 20.0)
    terrain = ground.to_map()
    assert terrain is not None
    rows, cols = terrain.height_m.shape
    edges = [terrain.origin_m[axis] + 0.25 * np.arange(size + 1) for axis, size in ((1, rows), (0, cols))]
    xy_m = np.concatenate([each + np.array([5.0 * i, 0]) for i, each in enumerate(scans)])
    height_m = np.concatenate(heights)
    count, *_ = binned_statistic_2d(xy_m[:, 1], xy_m[:, 0], height_m, "count", bins=edges)
    mean_m, *_ = binned_statistic_2d(xy_m[:, 1], xy_m[:, 0], height_m, "mean", bins=edges)
    np.testing.assert_array_equal(terrain.count, count)
    assert terrain.height_m == pytest.approx(mean_m, abs=1e-6, nan_ok=True)
    assert ground.lattice.skipped == 1
