from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.lidar.ransac_plane import GroundPlane, fit_ground, height_above_ground, is_level, ransac_iterations
from quadlog.simulation.sensors.scene import import_open3d


@pytest.mark.parametrize(
    ("confidence", "inlier_share", "iterations"),
    [
        *((0.99, 0.3, 169), (0.99, 0.5, 35), (0.99, 0.8, 7), (0.999, 0.9, 6), (0.5, 0.999999, 1)),
        *((0.99, 1.0, 1), (0.99, 1e-200, 100_000), (0.99, 0.001, 100_000)),
    ],
)
def test_iterations_by_the_formula(confidence: float, inlier_share: float, iterations: int) -> None:
    assert ransac_iterations(confidence, inlier_share) == iterations


@given(st.integers(0, 2**32), st.floats(-40, 40), st.floats(-40, 40), st.floats(-2, 2), st.floats(0.35, 0.9))
def test_planted_plane_is_found(
    seed: int, roll_deg: float, pitch_deg: float, height_m: float, inlier_share: float
) -> None:
    random = np.random.default_rng(seed)
    normal = np.array([np.tan(np.deg2rad(pitch_deg)), np.tan(np.deg2rad(roll_deg)), 1.0])
    normal /= np.linalg.norm(normal)
    n_plane = int(1000 * inlier_share)
    xy_m = random.uniform(-10, 10, (n_plane, 2))
    z_m = (height_m - xy_m @ normal[:2]) / normal[2] + random.normal(0, 0.01, n_plane)
    clutter = random.uniform(-10, 10, (1000 - n_plane, 3))
    cloud = np.concatenate([np.column_stack([xy_m, z_m]), clutter])

    found = fit_ground(cloud, 0.1, 0.999999, 0.3, 100, seed=1)

    assert found is not None
    assert found.normal[2] > 0
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)
    assert np.rad2deg(np.arccos(min(found.normal @ normal, 1.0))) < 0.5
    assert -found.d_m == pytest.approx(height_m, abs=0.03)
    assert found.inliers[:n_plane].mean() > 0.99
    assert (np.abs(cloud @ found.normal + found.d_m) <= 0.1).tolist() == found.inliers.tolist()


def test_ring_scan_agrees_with_open3d(ring_scan) -> None:
    xyz_m, kinds = ring_scan
    open3d = import_open3d()
    open3d.utility.random.seed(0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz_m))
    plane, inliers = cloud.segment_plane(0.1, 3, 1000)

    found = fit_ground(xyz_m, 0.1, 0.99, 0.3, 100, seed=0)

    assert found is not None
    assert np.abs(found.normal) @ np.abs(plane[:3]) == pytest.approx(1.0, abs=1e-4)
    assert abs(found.d_m) == pytest.approx(abs(plane[3]), abs=0.02)
    theirs = np.isin(np.arange(len(xyz_m)), inliers)
    assert (found.inliers & theirs).sum() / (found.inliers | theirs).sum() > 0.97
    assert found.inliers[kinds["floor"]].mean() > 0.98


@pytest.mark.parametrize(
    "cloud",
    [
        np.empty((0, 3)),
        np.ones((1, 3)),
        np.ones((500, 3)),
        np.outer(np.linspace(0, 9, 500), [1.0, 2.0, 3.0]),
        np.random.default_rng(0).normal(0, 1, (99, 3)),
    ],
    ids=["empty", "one point", "one place", "one line", "fewer than min_points"],
)
def test_degenerate_clouds_have_no_plane(cloud: np.ndarray) -> None:
    assert fit_ground(cloud, 0.1, 0.99, 0.3, 100, seed=0) is None


def test_a_plane_that_few_points_support_is_none() -> None:
    scattered = np.random.default_rng(0).uniform(-50, 50, (1000, 3))
    assert fit_ground(scattered, 0.01, 0.99, 0.3, 100, seed=0) is None


def plane_of(normal: tuple[float, float, float], point: tuple[float, float, float]) -> GroundPlane:
    unit = np.array(normal) / np.linalg.norm(normal)
    return GroundPlane(unit, float(-unit @ np.array(point)), np.zeros(0, dtype=np.bool_))


def test_heights_are_vertical_above_a_tilted_plane() -> None:
    slope = plane_of((-np.tan(np.deg2rad(20)), 0.0, 1.0), (0.0, 0.0, -0.5))
    on_slope = np.array([3.0, 1.0, -0.5 + 3.0 * np.tan(np.deg2rad(20))])
    heights = height_above_ground(on_slope + np.array([[0, 0, 0], [0, 0, 0.8], [0, 0, -0.2]]), slope)
    assert heights == pytest.approx([0.0, 0.8, -0.2])


def test_heights_are_not_measured_from_walls() -> None:
    wall = plane_of((-1.0, 0.0, 0.05), (6.0, 0.0, 0.0))
    assert not is_level(wall)
    assert is_level(plane_of((0.0, 0.9, 1.0), (0.0, 0.0, 0.0)))
    assert not is_level(None)
    assert height_above_ground(np.array([[2.0, 0.0, 0.5]]), wall).tolist() == [0.5]
