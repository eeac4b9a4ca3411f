from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from quadlog.geometry import transform_from_rpy
from quadlog.lidar.classified_scan import PointClass
from quadlog.lidar.paper_method import PaperSettings, fit_ground, ransac_iterations, statistical_outliers
from quadlog.open3d import import_open3d

LEVEL = transform_from_rpy(np.array([0.0, 0.0, 0.5]), 0.0, 0.0, 0.0)
ALL_ROUND = PaperSettings(field_of_view_deg=360.0)


@pytest.fixture(scope="module")
def room(room_scan):
    """A room of 16 m with 1 % of false ranges: points, rings, which are floor and which false."""
    xyz_m, *others = room_scan(LEVEL, wall_m=8.0, n_azimuth=320, false_share=0.01)
    return xyz_m.astype(np.float64), *others


@pytest.mark.parametrize(("neighbours", "std_ratio"), [(20, 2.0), (5, 1.0), (1, 0.5)])
def test_outliers_are_those_of_the_definition(room, neighbours: int, std_ratio: float) -> None:
    """To the last point, against scipy's tree; rounding decides about none."""
    xyz_m = room[0]
    distances_m, _ = cKDTree(xyz_m).query(xyz_m, neighbours + 1)
    mean_m = distances_m[:, 1:].mean(axis=1)
    limit_m = mean_m.mean() + std_ratio * mean_m.std(ddof=1)
    found = statistical_outliers(xyz_m, neighbours, std_ratio)
    assert found.any()
    assert (np.abs(mean_m - limit_m) > 1e-9 * limit_m).all()
    assert (found == (mean_m > limit_m)).all()


def test_iterations_by_the_formula() -> None:
    counts = {0.3: 169, 0.5: 35, 0.999999: 1, 1.0: 1, 1e-200: 100_000}
    assert {share: ransac_iterations(0.99, share) for share in counts} == counts


@given(st.integers(0, 2**32), st.floats(-40, 40), st.floats(-40, 40), st.floats(-2, 2), st.floats(0.35, 0.9))
def test_planted_plane_is_found(seed: int, roll_deg: float, pitch_deg: float, height_m: float, share: float) -> None:
    random, n_plane = np.random.default_rng(seed), int(1000 * share)
    normal = np.array([np.tan(np.deg2rad(pitch_deg)), np.tan(np.deg2rad(roll_deg)), 1.0])
    normal /= np.linalg.norm(normal)
    cloud = random.uniform(-10, 10, (1000, 3))
    noise_m = random.normal(0, 0.01, n_plane)
    cloud[:n_plane, 2] = (height_m - cloud[:n_plane, :2] @ normal[:2]) / normal[2] + noise_m
    plane, on_plane = fit_ground(cloud, replace(ALL_ROUND, ground_confidence=0.999999), seed=1)
    assert plane.normal[2] > 0
    assert np.rad2deg(np.arccos(min(plane.normal @ normal, 1.0))) < 0.5
    assert -plane.d_m == pytest.approx(height_m, abs=0.03)
    assert on_plane[:n_plane].mean() > 0.99
    assert plane.height_m(cloud[on_plane] + np.array([0, 0, 0.8])) == pytest.approx(0.8, abs=0.14), "vertical"
    assert (np.abs(cloud @ plane.normal + plane.d_m) <= 0.1).tolist() == on_plane.tolist()


def test_the_plane_is_open3ds(room) -> None:
    geometry, utility = import_open3d().geometry, import_open3d().utility
    utility.random.seed(0)
    theirs, inliers = geometry.PointCloud(utility.Vector3dVector(room[0])).segment_plane(0.1, 3, 1000)
    ours, on_plane = fit_ground(room[0], ALL_ROUND, seed=0)
    assert np.abs(ours.normal) @ np.abs(theirs[:3]) == pytest.approx(1.0, abs=1e-4)
    both = np.isin(np.arange(len(on_plane)), inliers)
    assert (on_plane & both).sum() / (on_plane | both).sum() > 0.97


@pytest.mark.parametrize(
    "cloud",
    [np.empty((0, 3)), np.ones((500, 3)), np.outer(np.linspace(0, 9, 500), [1.0, 2.0, 3.0]),
     np.random.default_rng(0).normal(0, 1, (99, 3)), np.random.default_rng(0).uniform(-500, 500, (1000, 3))],
    ids=["empty", "one place", "one line", "fewer than min_points", "scattered"],
)  # fmt: skip
def test_degenerate_clouds_have_no_plane(cloud: np.ndarray) -> None:
    assert fit_ground(cloud, ALL_ROUND, seed=0) is None


def test_room_is_split_into_floor_and_walls(classify, room) -> None:
    xyz_m, _, floor, false = room
    scan, again = (classify(xyz_m, None, LEVEL, ALL_ROUND) for _ in range(2))
    assert (scan.route, scan.counts[:2]) == ("paper", [0, 0])
    assert [*scan.ground.normal, scan.ground.d_m] == pytest.approx([0, 0, 1, 0], abs=0.03)  # base is on the floor
    assert (scan.label[floor] == PointClass.GROUND).mean() > 0.98
    assert (scan.label[~floor & ~false & (xyz_m[:, 2] > -0.3)] == PointClass.OBSTACLE).mean() > 0.95
    assert (scan.label[false] == PointClass.OUTLIER).mean() > 0.1
    assert np.abs(scan.height_m[scan.label == PointClass.GROUND]).max() <= 0.101
    assert again.label.tobytes() == scan.label.tobytes()
