from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import apply_transform
from quadlog.lidar.classified_scan import PointClass
from tests.lab.labelled_scans import (
    PLACES,
    labelled_scans,
)


@pytest.fixture(scope="module")
def scans():
    """Four scans of every place."""
    return {name: list(labelled_scans(name, seed=7, n=4)) for name in PLACES}


def of_class(scan, wanted):
    return scan.xyz_lidar_m[scan.truth == wanted].astype(np.float64)


def in_map(scan, wanted):
    return apply_transform(scan.transform_base_to_map @ scan.transform_lidar_to_base, of_class(scan, wanted))


@pytest.mark.parametrize("name", PLACES)
def test_one_percent_are_outliers_and_the_rest_is_ground_and_obstacles(scans, name):
    truth = np.concatenate([scan.truth for scan in scans[name]])
    assert set(np.unique(truth)) == {PointClass.OUTLIER, PointClass.GROUND, PointClass.OBSTACLE}
    assert np.mean(truth == PointClass.OUTLIER) == pytest.approx(0.01, abs=4 * np.sqrt(0.01 / len(truth)))
    assert np.mean(truth == PointClass.GROUND) > (0.05 if name == "corridor" else 0.3)
    assert np.mean(truth == PointClass.OBSTACLE) > 0.03


@pytest.mark.parametrize("name", PLACES)
def test_heights_are_above_the_true_ground(scans, name):
    for scan in scans[name]:
        assert np.array_equal(np.isnan(scan.height_m), scan.truth == PointClass.OUTLIER)
        assert np.abs(scan.height_m[scan.truth == PointClass.GROUND]).max() < 1e-3
        obstacle = scan.height_m[scan.truth == PointClass.OBSTACLE]
        assert obstacle.min() > -0.12  # a leg swings over a slope
        assert np.mean(obstacle < 0) < 0.02


def test_ranges_of_ground_points_on_the_flat_are_those_to_a_plane(scans):
    errors = []
    for scan in scans["flat"]:
        turn = (scan.transform_base_to_map @ scan.transform_lidar_to_base)[:3, :3]
        points = of_class(scan, PointClass.GROUND)
        range_m = np.linalg.norm(points, axis=1)
        down = -(points / range_m[:, None] @ turn.T)[:, 2]
        sensor_m = (scan.transform_base_to_map @ scan.transform_lidar_to_base)[2, 3]
        errors.append(range_m - sensor_m / down)
    error = np.concatenate(errors)
    assert error.std() == pytest.approx(0.02, rel=0.02)
    assert error.mean() == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("name", "angle_deg"), [("slope_15", 15.0), ("slope_20", 20.0)])
def test_a_slopes_ground_is_its_plane_and_the_body_is_parallel_or_level(scans, name, angle_deg):
    for index, scan in enumerate(scans[name]):
        x, _, z = in_map(scan, PointClass.GROUND).T
        off = (z - np.tan(np.deg2rad(angle_deg)) * x) * np.cos(np.deg2rad(angle_deg))
        assert np.abs(off).max() < 6 * 0.02
        up = scan.transform_base_to_map[:3, 2]
        tilt_deg = np.rad2deg(np.arccos(up @ [0.0, 0.0, 1.0]))
        if index == 0:
            assert tilt_deg == pytest.approx(angle_deg, abs=1e-6)
        elif index == 2:
            assert tilt_deg == pytest.approx(0.0, abs=1e-5)
        else:
            assert 0.1 < abs(tilt_deg - (angle_deg if index < 2 else 0.0)) < 12.0
