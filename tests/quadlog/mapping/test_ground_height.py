from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binned_statistic_2d

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import PointClass
from quadlog.mapping.accumulated_map import GroundHeight


@pytest.fixture
def add(compacted):
    """Add points of base that are all ground, with one of another class among them."""

    def run(ground: GroundHeight, xy_m, height_m, pose: tuple = (0.0, 0.0, 0.0), **settings) -> None:
        xyz_m = np.column_stack([xy_m, height_m])
        label = np.full(len(xyz_m), PointClass.GROUND, dtype=np.uint8)
        at = len(xyz_m) // 2
        xyz_m, label = np.insert(xyz_m, at, [[3.0, 3.0, 99.0]], axis=0), np.insert(label, at, PointClass.OBSTACLE)
        ground.add(compacted(xyz_m, label, **settings), np.array([pose]))

    return run


def test_mean_heights_agree_with_scipy(add) -> None:
    """Cells of base that are those of map lose nothing."""
    random = np.random.default_rng(0)
    ground = GroundHeight(0.25)
    scans = [random.uniform(-10, 10, (4000, 2)) for _ in range(4)]
    heights = [random.normal(0, 0.1, 4000) for _ in scans]
    for i, (xy_m, height_m) in enumerate(zip(scans, heights, strict=True)):
        add(ground, xy_m, height_m, (5.0 * i, 0.0, 0.0), ground_cell_m=0.25, reach_m=20.0)

    terrain = ground.to_map()

    assert terrain is not None
    rows, cols = terrain.height_m.shape
    edges = [terrain.origin_m[axis] + 0.25 * np.arange(size + 1) for axis, size in ((1, rows), (0, cols))]
    xy_m = np.concatenate([each + np.array([5.0 * i, 0]) for i, each in enumerate(scans)])
    height_m = np.concatenate(heights)
    mean_m, *_ = binned_statistic_2d(xy_m[:, 1], xy_m[:, 0], height_m, "mean", bins=edges)
    count, *_ = binned_statistic_2d(xy_m[:, 1], xy_m[:, 0], height_m, "count", bins=edges)
    assert terrain.count.sum() == 16000
    assert (terrain.count == count).mean() > 0.99, "a mean on the edge of a cell is rounded to a millimetre"
    assert terrain.height_m[terrain.count == count] == pytest.approx(
        mean_m[terrain.count == count], abs=1e-3, nan_ok=True
    )


def test_points_are_placed_in_map_by_the_pose(add) -> None:
    ground = GroundHeight(0.5)
    add(ground, np.array([[2.2, 1.3]]), np.array([0.25]), (10.0, -4.0, 0.7))
    terrain = ground.to_map()
    x_m, y_m, _ = apply_transform(transform_from_rpy(np.array([10, -4, 0]), 0, 0, 0.7), np.array([[2.2, 1.3, 0]]))[0]
    assert terrain is not None
    assert terrain.origin_m == pytest.approx(np.floor(np.array([x_m, y_m]) / 0.5) * 0.5)
    assert terrain.height_m.tolist() == [[0.25]]


def test_nothing_seen_is_none(add) -> None:
    ground = GroundHeight(0.2)
    add(ground, np.empty((0, 2)), np.empty(0))
    assert ground.to_map() is None


def test_a_scan_beyond_the_limit_is_skipped_and_counted(add) -> None:
    ground = GroundHeight(0.2)
    add(ground, np.array([[0.1, 0.1]]), np.array([0.5]))
    add(ground, np.array([[0.1, 0.1]]), np.array([0.5]), (1e9, 0.0, 0.0))
    terrain = ground.to_map()
    assert ground.skipped == 1
    assert terrain is not None
    assert terrain.height_m.tolist() == [[0.5]]
