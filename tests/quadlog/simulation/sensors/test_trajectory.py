from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.robot.height_field import slope
from quadlog.simulation.sensors.trajectory import (
    ROBOT_FEET_M,
    OnTerrain,
    PacingWalk,
    Route,
    RouteWalk,
    turned_into_map,
)
from quadlog.simulation.synthetic import follow
from tests.lab.labelled_scans import Standing

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


T_S = np.linspace(0.0, 20.0, 60)


@pytest.mark.parametrize("yaw", [0.0, 0.7, np.pi / 2, -2.5])
def test_a_robot_on_a_slope_stands_at_right_angles_to_it(yaw):
    angle = np.deg2rad(20.0)
    motion = OnTerrain(Standing(3.0, -1.0, yaw), slope(angle), ROBOT_FEET_M).at(T_S)
    up = turned_into_map(motion, np.tile([0.0, 0.0, 1.0], (len(T_S), 1)))
    np.testing.assert_allclose(up, np.tile([-np.sin(angle), 0.0, np.cos(angle)], (len(T_S), 1)), atol=1e-12)
    ahead = turned_into_map(motion, np.tile([1.0, 0.0, 0.0], (len(T_S), 1)))
    np.testing.assert_allclose(np.arctan2(ahead[:, 1], ahead[:, 0]), yaw, atol=1e-12)
    np.testing.assert_allclose(motion.height_m, 3.0 * np.tan(angle), atol=1e-12)
