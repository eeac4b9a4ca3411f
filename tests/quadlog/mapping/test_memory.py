from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binned_statistic_2d

from quadlog.lidar.classified_scan import PointClass
from quadlog.mapping.grid import GrowingLattice, SlidingLattice, Window, window_around
from quadlog.mapping.memory import FREE, OCCUPIED, UNKNOWN, AccumulatedMap, GroundHeight, LogOddsMemory
from quadlog.mapping.placing import NO_RAY, NO_TOP, PlacedScan

WINDOW = Window(0, 0, 0.1, (10, 12))
STEP_NS = 100_000_000


def rays(lowest_m: float) -> np.ndarray:
    return np.full(WINDOW.shape, round(1000 * lowest_m), dtype=np.int16)


UNSEEN = np.full(WINDOW.shape, NO_RAY, dtype=np.int16)
SEEN_THROUGH = rays(0.0)


def seen(*cells: tuple[int, int], top_m: float = 1.0, ray: np.ndarray = SEEN_THROUGH) -> PlacedScan:
    top = np.full(WINDOW.shape, NO_TOP, dtype=np.int16)
    for cell in cells:
        top[cell] = round(1000 * top_m)
    return PlacedScan(top, ray)


def log_odds(clear_s: float = 0.4, lattice=SlidingLattice, **size: int) -> LogOddsMemory:
    return LogOddsMemory(lattice(0.1, LogOddsMemory.LAYERS, **size), clear_s)


@pytest.mark.parametrize("rate_hz", [5, 10, 20])
def test_moving_obstacles_are_cleared_within_half_a_second_and_false_points_sooner(rate_hz: int) -> None:
    memory, step_ns = log_odds(), 10**9 // rate_hz
    for k in range(20):
        assert memory.add(k * step_ns, WINDOW, seen((5, 5), (7, 7)) if k == 19 else seen((5, 5)))[5, 5]
    after = [memory.add((20 + k) * step_ns, WINDOW, seen()) for k in range(rate_hz)]
    gone, false = ([bool(grid[cell]) for grid in after] for cell in ((5, 5), (7, 7)))
    assert not any(gone[rate_hz // 2 - 1 :]), "a ghost half a second after the last hit"
    assert any(gone) or rate_hz == 5, "one glance past an obstacle must not clear it"
    assert sum(false) < sum(gone) or rate_hz == 5


@pytest.mark.parametrize(
    ("ray", "stays"), [(UNSEEN, True), (rays(0.46), True), (rays(0.45), False), (rays(0.29), False)]
)
def test_only_rays_at_its_height_or_below_contradict_an_obstacle(ray: np.ndarray, stays: bool) -> None:
    """A 2-D lidar has none below the plane in which something was hit."""
    memory = log_odds()
    memory.add(0, WINDOW, seen((5, 5), top_m=0.45, ray=UNSEEN))
    kept = [memory.add(k * STEP_NS, WINDOW, seen(ray=ray))[5, 5] for k in range(1, 50)]
    assert kept[2:] == [stays] * 47


@pytest.mark.parametrize(
    ("lattice", "size", "comes_back", "skipped"),
    [(SlidingLattice, {}, False, 0), (GrowingLattice, {}, True, 0), (GrowingLattice, {"most_cells": 200}, True, 1)],
)
def test_the_window_slides_and_what_it_leaves_is_dropped_or_kept(lattice, size, comes_back, skipped) -> None:
    """A scan for which there is no room is a map of its own."""
    memory, nothing = log_odds(100.0, lattice, **size), seen(ray=UNSEEN)
    near, beside, away = WINDOW, Window(3, -2, 0.1, (10, 12)), Window(50, 0, 0.1, (10, 12))
    memory.add(10**9, near, seen((5, 5), ray=UNSEEN))
    assert np.argwhere(memory.add(2 * 10**9, beside, nothing)).tolist() == [[7, 2]]
    assert np.argwhere(memory.add(3 * 10**9, away, seen((1, 1), ray=UNSEEN))).tolist() == [[1, 1]]
    assert np.argwhere(memory.add(4 * 10**9, near, nothing)).tolist() == [[5, 5]] * comes_back
    assert memory.lattice.skipped == skipped


@pytest.mark.parametrize("passes", [1, 2, 10])
def test_a_crate_outlasts_the_person_who_stepped_over_it(passes: int) -> None:
    """It is out of the beams' reach then; they pass half a metre above it, where the person was."""
    memory = log_odds()
    scans = [seen((5, 5), top_m=0.2, ray=UNSEEN)] * 5 + [seen((5, 5), top_m=1.4, ray=UNSEEN)] * passes
    scans += [seen(ray=rays(0.7))] * 50 + [seen(ray=rays(0.15))] * 5
    kept = [bool(memory.add(k * STEP_NS, WINDOW, scan)[5, 5]) for k, scan in enumerate(scans)]
    assert all(kept[:-5])
    assert not all(kept[-5:]), "what is taken away is forgotten as before"


def test_cells_by_their_share_of_hits_agree_with_one_fixed_array_and_poses_far_off_are_skipped() -> None:
    """What is hit is not seen through in the same scan, and what is seen through above the robot says nothing."""
    random, whole, counts = np.random.default_rng(0), AccumulatedMap(0.5), np.zeros((2, 400, 400), np.int64)
    hit, ray_mm = random.random((122, 20, 20)) < 0.2, random.choice([NO_RAY, 400, 399], (122, 20, 20)).astype(np.int16)
    positions_m = [*np.cumsum(random.uniform(-1, 2, (120, 2)), axis=0) - 30, [1e8, 0.0], [-1e15, 0.0]]
    for position_m, top_mm, lowest_mm in zip(positions_m, np.where(hit, np.int16(500), NO_TOP), ray_mm, strict=True):
        window = window_around(np.array(position_m), 0.5, 20)
        whole.add(window, PlacedScan(top_mm, lowest_mm), 400)
        if abs(window.col0) < 200:
            there = np.s_[window.row0 + 200 : window.row0 + 220, window.col0 + 200 : window.col0 + 220]
            counts[0][there] += top_mm > NO_TOP
            counts[1][there] += (lowest_mm < 400) & (top_mm == NO_TOP)
    cells, held = whole.to_cells()
    rows, cols = held.shape
    hits, passes = counts[:, held.row0 + 200 : held.row0 + 200 + rows, held.col0 + 200 : held.col0 + 200 + cols]
    assert hits.sum() + passes.sum() == counts.sum()
    expected = np.select([hits + passes == 0, hits >= 0.3 * (hits + passes)], [UNKNOWN, OCCUPIED], FREE)
    assert (cells == expected).all()
    assert whole.lattice.skipped == 2


def test_mean_heights_agree_with_scipy_and_a_scan_beyond_the_limit_is_skipped(scanned) -> None:
    random, ground = np.random.default_rng(0), GroundHeight(0.25)
    label = [PointClass.GROUND] * 4000 + [PointClass.OBSTACLE]
    xyz_m = np.concatenate([random.uniform(-10, 10, (4, 4001, 2)), random.normal(0, 0.1, (4, 4001, 1))], axis=2)
    for x_m, points_m in zip((0.0, 5.0, 10.0, 15.0), xyz_m, strict=True):
        ground.add(scanned(points_m, label), np.array([[x_m, 0.0, 0.0]]), 20.0)
    ground.add(scanned([[0.1, 0.1, 0.5]], PointClass.GROUND), np.array([[1e9, 0.0, 0.0]]), 20.0)
    assert ground.lattice.skipped == 1
    x_m, y_m, z_m = (xyz_m[:, :4000] + np.array([[[5.0 * i, 0, 0]] for i in range(4)])).reshape(-1, 3).T
    height_m, count, window = ground.to_map()
    edges = [window.origin_m[k] + 0.25 * np.arange(window.shape[1 - k] + 1) for k in (1, 0)]
    for statistic, found in (("count", count), ("mean", height_m)):
        expected, *_ = binned_statistic_2d(y_m, x_m, z_m, statistic, bins=edges)
        assert found == pytest.approx(expected, abs=1e-6, nan_ok=True)
    assert count.sum() == 16_000
