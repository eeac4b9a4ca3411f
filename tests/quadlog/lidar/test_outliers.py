from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from quadlog.lidar.statistical_outliers import statistical_outliers
from quadlog.simulation.sensors.scene import import_open3d


def by_definition(xyz_m: np.ndarray, neighbours: int, std_ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """D_i > mu + n sigma with scipy, and which points lie so near to the limit that rounding may decide."""
    distances, _ = cKDTree(xyz_m).query(xyz_m, neighbours + 1)
    mean = distances[:, 1:].mean(axis=1)
    limit = mean.mean() + std_ratio * mean.std(ddof=1)
    return mean > limit, np.abs(mean - limit) < 1e-9 * max(limit, 1e-9)


def by_open3d(xyz_m: np.ndarray, neighbours: int, std_ratio: float) -> np.ndarray:
    """The outliers that Open3D finds; it counts the point itself as its own nearest neighbour."""
    open3d = import_open3d()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz_m))
    _, kept = cloud.remove_statistical_outlier(nb_neighbors=neighbours + 1, std_ratio=std_ratio)
    outlier = np.ones(len(xyz_m), dtype=np.bool_)
    outlier[np.asarray(kept, dtype=np.int64)] = False
    return outlier


def returns(scan: np.ndarray) -> np.ndarray:
    """The points of a raw scan that are returns at all, as float64."""
    scan = scan.astype(np.float64)
    return scan[np.isfinite(scan).all(axis=1) & (np.abs(scan).sum(axis=1) > 0)]


def assert_same_set(xyz_m: np.ndarray, neighbours: int = 20, std_ratio: float = 2.0) -> None:
    """The set is that of scipy's and of Open3D's search, to the last point."""
    expected, near = by_definition(xyz_m, neighbours, std_ratio)
    found = statistical_outliers(xyz_m, neighbours, std_ratio)
    assert found.any()
    assert not near.any()  # rounding decides about none of these points
    assert (found == expected).all()
    assert (found == by_open3d(xyz_m, neighbours, std_ratio)).all()


@pytest.mark.parametrize(("neighbours", "std_ratio"), [(20, 2.0), (5, 1.0), (1, 0.5)])
def test_ring_scan_has_the_outliers_of_scipy_and_open3d(ring_scan, neighbours: int, std_ratio: float) -> None:
    assert_same_set(ring_scan[0], neighbours, std_ratio)


def test_scan_of_thirty_thousand_points_has_the_outliers_of_scipy_and_open3d(large_ring_scan) -> None:
    assert_same_set(large_ring_scan)


def test_real_scans_have_the_outliers_of_scipy_and_open3d(real_scans) -> None:
    for scans in real_scans.values():
        for scan in scans:
            assert_same_set(returns(scan))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 80), st.integers(1, 6), st.sampled_from([0.5, 1.0, 2.0]), st.booleans())
def test_small_clouds_and_duplicates_agree_with_scipy(
    seed: int, n_points: int, neighbours: int, std_ratio: float, on_few_places: bool
) -> None:
    random = np.random.default_rng(seed)
    if on_few_places:
        xyz_m = random.integers(0, 3, (n_points, 3)).astype(np.float64)
    else:
        xyz_m = random.normal(0, 1, (n_points, 3))
    found = statistical_outliers(xyz_m, neighbours, std_ratio)
    if n_points <= neighbours:
        assert not found.any()
        return
    expected, near = by_definition(xyz_m, neighbours, std_ratio)
    assert (found == expected)[~near].all()


def test_evenly_spaced_points_have_no_outliers() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    assert not statistical_outliers(corners, 3, 1.0).any()


@pytest.mark.parametrize("n_points", [0, 1, 20])
def test_too_few_points_have_no_outliers(n_points: int) -> None:
    assert not statistical_outliers(np.random.default_rng(0).normal(0, 1, (n_points, 3)), 20, 2.0).any()
