from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binned_statistic_2d

from quadlog.lidar.classified_scan import PointClass
from quadlog.mapping.grid import Window, window_around
from quadlog.mapping.memory import FREE, OCCUPIED, AccumulatedMap, GroundHeight
from quadlog.mapping.placing import NO_TOP, PlacedScan
from quadlog.mapping.ray_tracing import NO_RAY


def grid(window: Window, *cells: tuple[int, int]) -> np.ndarray:
    occupied = np.zeros(window.shape, dtype=np.bool_)
    for col, row in cells:
        occupied[row, col] = True
    return occupied


def add(whole: AccumulatedMap, window: Window, hit: np.ndarray, crossed: np.ndarray) -> None:
    top_mm = np.where(hit, np.int16(500), NO_TOP)
    # What is seen through above the robot says nothing.
    whole.add(window, PlacedScan(top_mm, np.where(crossed, np.int16(399), np.where(hit, NO_RAY, np.int16(400)))), 400)


def test_a_cell_is_occupied_by_its_share_of_hits() -> None:
    window = Window(0, 0, 1.0, (1, 10))
    nothing = grid(window)
    for hits, passes, expected in ((3, 7, OCCUPIED), (2, 7, FREE), (1, 0, OCCUPIED)):
        whole = AccumulatedMap(1.0)
        for _ in range(hits):
            add(whole, window, grid(window, (4, 0)), nothing)
        for _ in range(passes):
            add(whole, window, nothing, grid(window, (4, 0)))
        assert whole.to_cells()[0][0, 4] == expected


def test_sliding_windows_agree_with_one_fixed_array() -> None:
    random = np.random.default_rng(0)
    whole = AccumulatedMap(0.5)
    counts = np.zeros((400, 400), dtype=np.int64)
    for position in np.cumsum(random.uniform(-3, 5, (40, 2)), axis=0) - 30:
        window = window_around(position, 0.5, 20)
        occupied = random.random((20, 20)) < 0.1
        add(whole, window, occupied, np.zeros_like(occupied))
        counts[window.row0 + 200 : window.row0 + 220, window.col0 + 200 : window.col0 + 220] += occupied
    cells, held = whole.to_cells()
    rows, cols = held.shape
    inside = counts[held.row0 + 200 : held.row0 + 200 + rows, held.col0 + 200 : held.col0 + 200 + cols]
    assert inside.sum() == counts.sum()
    assert (whole.lattice.view("hits", held) == inside).all()
    assert ((cells == OCCUPIED) == (inside > 0)).all()
    assert whole.lattice.skipped == 0


def test_a_pose_far_off_is_skipped_and_counted() -> None:
    whole = AccumulatedMap(0.1)
    for x_m in (0.0, 1e7, 5.0, -1e15):
        window = window_around(np.array([x_m, 0.0]), 0.1, 200)
        add(whole, window, grid(window, (3, 3)), grid(window))
    cells, held = whole.to_cells()
    assert whole.lattice.skipped == 2
    assert cells.shape == held.shape == (200, 250)
    assert (cells == OCCUPIED).sum() == 2


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
