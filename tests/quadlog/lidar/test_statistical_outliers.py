from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from quadlog.lidar.statistical_outliers import mean_neighbour_distances, statistical_outliers
from quadlog.simulation.sensors.scene import import_open3d

SHAPES = ("normal", "uniform", "plane", "line", "circle", "clusters", "few places", "lattice", "twice", "far outlier")


def make_cloud(shape: str, n_points: int, random: np.random.Generator) -> np.ndarray:
    """Clouds that are unkind to a tree each in its own way: flat, thin, hollow, uneven or full of equal distances."""
    xyz_m = random.normal(0, 1, (n_points, 3))
    angle_rad = random.uniform(0, 2 * np.pi, n_points)
    match shape:
        case "uniform":
            return random.uniform(-5, 5, (n_points, 3))
        case "plane":
            return xyz_m * [4.0, 1.0, 0.0]
        case "line":
            return xyz_m[:, :1] * [[1.0, -2.0, 0.5]]
        case "circle":
            circle = np.stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(n_points)], axis=1)
            return np.concatenate([circle[1:], np.zeros((1, 3))])
        case "clusters":
            return random.integers(0, 4, (n_points, 1)) * 100.0 + xyz_m * 10.0 ** random.integers(-6, 2, (n_points, 1))
        case "few places":
            return random.integers(0, 3, (n_points, 3)).astype(np.float64)
        case "lattice":
            return np.round(xyz_m * 4) / 4
        case "twice":
            return np.repeat(xyz_m[: (n_points + 1) // 2], 2, axis=0)[:n_points]
        case "far outlier":
            return np.concatenate([xyz_m[1:], [[1e12, -1e12, 3.0]]])
    return xyz_m


def by_scipy(xyz_m: np.ndarray, neighbours: int) -> np.ndarray:
    distances, _ = cKDTree(xyz_m).query(xyz_m, neighbours + 1)
    return distances[:, 1:].mean(axis=1)


@given(st.sampled_from(SHAPES), st.integers(2, 900), st.integers(1, 60), st.integers(0, 2**32), st.integers(-30, 30))
def test_any_cloud_agrees_with_scipy(shape: str, n_points: int, neighbours: int, seed: int, power: int) -> None:
    xyz_m = make_cloud(shape, n_points, np.random.default_rng(seed)) * 10.0**power
    neighbours = min(neighbours, n_points - 1)
    found = mean_neighbour_distances(xyz_m, neighbours)
    assert found == pytest.approx(by_scipy(xyz_m, neighbours), rel=1e-12, abs=0)


def test_float32_and_strided_points_are_taken_as_they_are(ring_scan) -> None:
    xyz_m = ring_scan[0][:400].astype(np.float32)
    expected = mean_neighbour_distances(xyz_m.astype(np.float64), 5)
    assert (mean_neighbour_distances(xyz_m, 5) == expected).all()
    assert (mean_neighbour_distances(np.asfortranarray(xyz_m), 5) == expected).all()


@pytest.mark.parametrize("power", [0, 140, -140])
def test_a_hundred_thousand_points_at_two_places(power: int) -> None:
    # Quadratic in anything, this would not end.
    xyz_m = np.zeros((100_000, 3))
    xyz_m[::1000, 1] = 10.0**power
    found = mean_neighbour_distances(xyz_m, 20)
    assert found.tolist() == [0.0] * 100_000
    assert mean_neighbour_distances(xyz_m[xyz_m[:, 1] == 0], 20).max() == 0.0


@pytest.mark.parametrize(("n_points", "neighbours"), [(0, 1), (1, 1), (20, 20), (5, 0)])
def test_too_few_points_are_refused(n_points: int, neighbours: int) -> None:
    with pytest.raises(ValueError, match=f"{n_points} points do not have {neighbours} neighbours"):
        mean_neighbour_distances(np.zeros((n_points, 3)), neighbours)


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
    """The set is that of scipy's and of Open3D's search, to the last point; rounding decides about none."""
    mean_m = by_scipy(xyz_m, neighbours)
    limit_m = mean_m.mean() + std_ratio * mean_m.std(ddof=1)
    found = statistical_outliers(xyz_m, neighbours, std_ratio)
    assert found.any()
    assert (np.abs(mean_m - limit_m) > 1e-9 * limit_m).all()
    assert (found == (mean_m > limit_m)).all()
    assert (found == by_open3d(xyz_m, neighbours, std_ratio)).all()


@pytest.mark.parametrize(("neighbours", "std_ratio"), [(20, 2.0), (5, 1.0), (1, 0.5)])
def test_ring_scan_has_the_outliers_of_scipy_and_open3d(ring_scan, neighbours: int, std_ratio: float) -> None:
    assert_same_set(ring_scan[0], neighbours, std_ratio)


def test_real_scans_have_the_outliers_of_scipy_and_open3d(real_scans) -> None:
    for scans in real_scans.values():
        for scan in scans:
            assert_same_set(returns(scan))


def test_evenly_spaced_points_have_no_outliers() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    assert not statistical_outliers(corners, 3, 1.0).any()


@pytest.mark.parametrize("n_points", [0, 1, 20])
def test_too_few_points_have_no_outliers(n_points: int) -> None:
    assert not statistical_outliers(np.random.default_rng(0).normal(0, 1, (n_points, 3)), 20, 2.0).any()
