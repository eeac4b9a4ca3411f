from __future__ import annotations

import numpy as np
import pytest

from quadlog.errors import UnknownName
from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import PointClass
from quadlog.simulation.synthetic.labelled_scans import (
    PLACES,
    labelled_scans,
)

RAYS = 30_000


@pytest.fixture(scope="module")
def scans():
    """Four scans of every place."""
    return {name: list(labelled_scans(name, seed=7, n=4)) for name in PLACES}


def of_class(scan, wanted):
    return scan.xyz_lidar_m[scan.truth == wanted].astype(np.float64)


def in_map(scan, wanted):
    return apply_transform(scan.transform_base_to_map @ scan.transform_lidar_to_base, of_class(scan, wanted))


def in_level(scan, wanted):
    """Upright about base's own origin, x ahead."""
    turn = scan.transform_base_to_map.copy()
    turn[:3, 3] = 0.0
    unturned = transform_from_rpy(np.zeros(3), 0.0, 0.0, -float(np.arctan2(turn[1, 0], turn[0, 0])))
    return apply_transform(unturned @ turn @ scan.transform_lidar_to_base, of_class(scan, wanted))


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


@pytest.mark.parametrize(("name", "angle_deg"), [("ramp_15", 15.0), ("ramp_20", 20.0)])
def test_a_ramp_lies_ahead_of_a_robot_on_the_flat(scans, name, angle_deg):
    for scan in scans[name]:
        x, _, z = in_map(scan, PointClass.GROUND).T
        assert np.abs(z[x < 1.4]).max() < 0.05
        on_ramp = (z > 0.15) & (z < 4.0 * np.tan(np.deg2rad(angle_deg)) - 0.1)
        assert on_ramp.sum() > 300
        rise, _ = np.polyfit(x[on_ramp], z[on_ramp], 1)
        assert np.rad2deg(np.arctan(rise)) == pytest.approx(angle_deg, abs=0.6)
        assert abs(np.arctan2(scan.transform_base_to_map[1, 0], scan.transform_base_to_map[0, 0])) <= 0.4


def test_the_wall_ahead_is_near_and_across_the_way(scans):
    for scan in scans["wall_ahead"]:
        x, y, z = in_level(scan, PointClass.OBSTACLE).T
        ahead = (np.abs(y) < 1.0) & (x > 0) & (z < 0.6)
        assert 1.3 < x[ahead].min() < 4.4
        assert ahead.sum() > 800
        askew, near_m = np.polyfit(y[ahead], x[ahead], 1)
        np.testing.assert_allclose(x[ahead], askew * y[ahead] + near_m, atol=0.1)


def test_a_person_stands_one_to_three_metres_ahead(scans):
    for name in ("flat", "corridor", "forest", "slope_15"):
        found = 0
        for scan in scans[name]:
            x, y, _ = in_level(scan, PointClass.OBSTACLE).T
            found += np.count_nonzero((np.hypot(x, y) < 3.4) & (x > 0.9) & (np.abs(y) < 0.9)) > 30
        assert found >= 3


def test_every_other_scan_is_tilted_by_the_gait_and_levelling_undoes_it():
    tilts = []
    for index, scan in enumerate(labelled_scans("flat", seed=11, n=8)):
        up = scan.transform_base_to_map[:3, 2]
        tilts.append(np.rad2deg(np.arccos(min(1.0, up[2]))))
        assert (tilts[-1] > 0) == (index % 2 == 1)
        assert np.abs(in_level(scan, PointClass.GROUND)[:, 2]).max() < 0.05
    assert 0.5 < np.mean(tilts[1::2]) < 6.0
    tilted = next(iter(list(labelled_scans("flat", seed=11, n=2))[1:]))
    assert (
        np.abs(apply_transform(tilted.transform_lidar_to_base, of_class(tilted, PointClass.GROUND))[:, 2]).max() > 0.05
    )


@pytest.mark.parametrize("name", ["undulating", "corridor", "forest"])
def test_scans_depend_on_seed_and_index(scans, name):
    again = list(labelled_scans(name, seed=7, n=2))
    for one, other in zip(scans[name], again, strict=False):
        np.testing.assert_array_equal(one.xyz_lidar_m, other.xyz_lidar_m)
        np.testing.assert_array_equal(one.truth, other.truth)
    assert not np.array_equal(again[0].xyz_lidar_m[:100], again[1].xyz_lidar_m[:100])
    (other_seed,) = labelled_scans(name, seed=8, n=1)
    assert not np.array_equal(other_seed.xyz_lidar_m[:100], again[0].xyz_lidar_m[:100])


def test_an_unknown_place_lists_the_known():
    with pytest.raises(UnknownName, match="wall_ahead"):
        next(labelled_scans("moon", 0, 1))
