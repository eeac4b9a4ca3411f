from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binned_statistic_2d

from quadlog.mapping.ground_height import GroundHeight


def test_mean_heights_agree_with_scipy() -> None:
    random = np.random.default_rng(0)
    ground = GroundHeight(0.25)
    scans = [random.uniform(-20, 15, (4000, 2)) + np.array([5 * i, 0]) for i in range(4)]
    heights = [random.normal(0, 0.1, 4000) for _ in scans]
    for xy_m, height_m in zip(scans, heights, strict=True):
        ground.add(xy_m, height_m)

    terrain = ground.to_map()

    assert terrain is not None
    rows, cols = terrain.height_m.shape
    edges = [terrain.origin_m[axis] + 0.25 * np.arange(size + 1) for axis, size in ((1, rows), (0, cols))]
    xy_m, height_m = np.concatenate(scans), np.concatenate(heights)
    mean_m, *_ = binned_statistic_2d(xy_m[:, 1], xy_m[:, 0], height_m, "mean", bins=edges)
    count, *_ = binned_statistic_2d(xy_m[:, 1], xy_m[:, 0], height_m, "count", bins=edges)
    assert terrain.count.tolist() == count.tolist()
    assert terrain.count.sum() == 16000
    assert terrain.height_m == pytest.approx(mean_m, abs=1e-6, nan_ok=True)


def test_nothing_seen_is_none() -> None:
    ground = GroundHeight(0.2)
    ground.add(np.empty((0, 2)), np.empty(0))
    assert ground.to_map() is None


def test_a_scan_beyond_the_limit_is_skipped_and_counted() -> None:
    ground = GroundHeight(0.2, most_cells=10_000)
    ground.add(np.array([[0.1, 0.1]]), np.array([0.5]))
    ground.add(np.array([[0.1, 0.1], [1e9, 0.0]]), np.array([0.5, 0.5]))
    terrain = ground.to_map()
    assert ground.skipped == 1
    assert terrain is not None
    assert terrain.height_m.tolist() == [[0.5]]
