from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.geometry import quat_from_euler
from quadlog.simulation.sensors.scene import slope, undulating
from quadlog.simulation.sensors.trajectory import (
    ROBOT_FEET_M,
    Motion,
    OnTerrain,
    PacingWalk,
    Route,
    RouteWalk,
    Standing,
    position_in_map,
    turned_from_level,
    turned_into_map,
)
from quadlog.simulation.synthetic import follow

STEP_S = 1e-4


def walks():
    route = Route(follow.WAYPOINTS_M)
    return [
        RouteWalk(route, 1.0, 0.7, sway_m=0.2, period_s=13.0),
        PacingWalk((1.0, 2.0), (5.0, -1.0), period_s=10.0),
    ]


@pytest.mark.parametrize("walk", walks(), ids=["route", "pacing"])
def test_motion_is_the_derivative_of_position(walk):
    t_s = np.linspace(0.1, 90.0, 700)
    motion, before, after = walk.at(t_s), walk.at(t_s - STEP_S), walk.at(t_s + STEP_S)
    velocity = (after.position_m - before.position_m) / (2 * STEP_S)
    heading = np.column_stack([np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)])
    np.testing.assert_allclose(velocity, heading * motion.speed_mps[:, None], atol=1e-5)
    turn = np.angle(np.exp(1j * (after.yaw_rad - before.yaw_rad))) / (2 * STEP_S)
    np.testing.assert_allclose(motion.yaw_rate_radps, turn, atol=1e-4)
    faster = (after.speed_mps - before.speed_mps) / (2 * STEP_S)
    np.testing.assert_allclose(motion.acceleration_mps2, faster, atol=1e-6)


def test_a_route_through_a_circle_has_its_length_and_curvature():
    angle = 2 * np.pi * np.arange(60) / 60
    route = Route(3.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    assert route.length_m == pytest.approx(6 * np.pi, rel=1e-5)
    position, heading, curvature = route.at(np.linspace(0, route.length_m, 500))
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), 3.0, rtol=1e-5)
    np.testing.assert_allclose(curvature, 1 / 3, rtol=2e-3)
    np.testing.assert_allclose(
        np.sum(position * np.column_stack([np.cos(heading), np.sin(heading)]), axis=1), 0, atol=2e-3
    )


def test_a_route_closes_and_goes_round_again():
    route = Route(follow.WAYPOINTS_M)
    first, second = route.at(np.array([0.5, 7.0])), route.at(np.array([0.5, 7.0]) + route.length_m)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


T_S = np.linspace(0.0, 20.0, 60)


def random_motion(count: int = 200) -> Motion:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1.2, 1.2, (count, 3))
    zero = np.zeros(count)
    place = rng.normal(size=(count, 2))
    return Motion(place, 2 * angles[:, 0], zero, zero, zero, rng.normal(size=count), angles[:, 1], angles[:, 2])


def rotation(motion: Motion) -> Rotation:
    return Rotation.from_euler("ZYX", np.column_stack([motion.yaw_rad, motion.pitch_rad, motion.roll_rad]))


def test_rotations_agree_with_scipy():
    motion, vectors = random_motion(), np.random.default_rng(1).normal(size=(200, 3))
    np.testing.assert_allclose(turned_into_map(motion, vectors), rotation(motion).apply(vectors), atol=1e-12)
    there = position_in_map(motion, vectors)
    base = np.column_stack([motion.position_m, motion.height_m])
    np.testing.assert_allclose(there, base + rotation(motion).apply(vectors), atol=1e-12)
    level = motion._replace(yaw_rad=np.zeros(200))
    np.testing.assert_allclose(turned_from_level(motion, vectors), rotation(level).inv().apply(vectors), atol=1e-12)


def test_quaternions_agree_with_scipy():
    motion = random_motion()
    ours = quat_from_euler(motion.yaw_rad, motion.pitch_rad, motion.roll_rad)
    np.testing.assert_allclose(np.linalg.norm(ours, axis=1), 1.0, atol=1e-12)
    assert (rotation(motion).inv() * Rotation.from_quat(ours)).magnitude().max() < 1e-7


def test_a_level_walkers_quaternion_is_that_of_its_yaw_to_the_bit():
    yaw, zero = np.linspace(-6.0, 6.0, 50), np.zeros(50)
    ours = quat_from_euler(yaw, zero, zero)
    np.testing.assert_array_equal(ours, np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)]))
    assert not np.signbit(ours[:, :2]).any()


@pytest.mark.parametrize("yaw", [0.0, 0.7, np.pi / 2, -2.5])
def test_a_robot_on_a_slope_stands_at_right_angles_to_it(yaw):
    angle = np.deg2rad(20.0)
    motion = OnTerrain(Standing(3.0, -1.0, yaw), slope(angle), ROBOT_FEET_M).at(T_S)
    up = turned_into_map(motion, np.tile([0.0, 0.0, 1.0], (len(T_S), 1)))
    np.testing.assert_allclose(up, np.tile([-np.sin(angle), 0.0, np.cos(angle)], (len(T_S), 1)), atol=1e-12)
    ahead = turned_into_map(motion, np.tile([1.0, 0.0, 0.0], (len(T_S), 1)))
    np.testing.assert_allclose(np.arctan2(ahead[:, 1], ahead[:, 0]), yaw, atol=1e-12)
    np.testing.assert_allclose(motion.height_m, 3.0 * np.tan(angle), atol=1e-12)


def test_a_person_stands_upright_at_the_grounds_height():
    walk, terrain = PacingWalk((-4.0, 1.0), (4.0, 2.0), period_s=10.0), slope(0.3)
    motion = OnTerrain(walk, terrain).at(T_S)
    np.testing.assert_allclose(motion.height_m, np.tan(0.3) * motion.position_m[:, 0], atol=1e-12)
    assert not motion.roll_rad.any()
    assert not motion.pitch_rad.any()


def test_on_uneven_ground_the_feet_are_near_it():
    terrain = undulating(np.random.default_rng(0), (0.0, 0.0), 12.0, band_m=0.06, correlation_m=1.0)
    motion = OnTerrain(PacingWalk((-7.0, 1.0), (7.0, 2.0), period_s=40.0), terrain, ROBOT_FEET_M).at(T_S)
    assert motion.pitch_rad.std() > 0.01
    gaps = []
    for x in (0.2, -0.2):
        for y in (0.13, -0.13):
            foot = position_in_map(motion, np.tile([x, y, 0.0], (len(T_S), 1)))
            gaps.append(foot[:, 2] - terrain.height_at(foot[:, :2]))
    # A plane cannot go through four points of a surface, but it errs evenly: diagonally opposite feet alike.
    np.testing.assert_allclose(np.sum(gaps, axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(gaps[0], gaps[3], atol=1e-3)
    assert np.abs(gaps).max() < 0.02
