from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.control.following.path import lookahead, nearest_on_path
from quadlog.control.following.pure_pursuit import ARRIVED_M, BRAKING_MPS2, Command, PathFollower


def command_at(x_m, y_m, yaw_rad, path, *settings, start_m=0.0) -> Command:
    follower = PathFollower(path, start_m)
    return follower.pursue(x_m, y_m, yaw_rad, follower.step(x_m, y_m, yaw_rad), *settings)


def circle(radius_m, turns=0.9, left=True):
    angle = np.linspace(0, 2 * np.pi * turns, 40001)
    sign = 1 if left else -1
    return np.stack([radius_m * np.sin(angle), sign * radius_m * (1 - np.cos(angle))], axis=1)


@pytest.mark.parametrize("radius_m", [2.0, 5.0, 20.0])
@pytest.mark.parametrize("lookahead_m", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("left", [True, False])
def test_on_a_circle_the_command_is_that_circle(radius_m, lookahead_m, left):
    """The chord from a tangent robot to any point of its circle gives 2 y_l / l^2 = 1 / R exactly."""
    command = command_at(0.0, 0.0, 0.0, circle(radius_m, left=left), lookahead_m, 0.6, 5.0)
    assert command.v_mps == pytest.approx(0.6)
    assert command.v_mps / command.yaw_rate_radps == pytest.approx(radius_m if left else -radius_m, rel=1e-4)
    assert math.hypot(command.lookahead_x_m, command.lookahead_y_m) == pytest.approx(lookahead_m)


def test_tight_curves_are_walked_slower_on_the_same_arc():
    command = command_at(0.0, 0.0, 0.0, circle(0.5), 0.4, 0.6, 0.3)
    assert abs(command.yaw_rate_radps) == pytest.approx(0.3)
    assert command.v_mps / command.yaw_rate_radps == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize("bearing_deg", [90, 135, 180, -120])
def test_a_point_behind_is_turned_to_on_the_spot(bearing_deg):
    end = 3 * np.array([math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))])
    command = command_at(0.0, 0.0, 0.0, np.array([[0.0, 0.0], end]), 1.0, 0.6, 1.5)
    assert command.v_mps == pytest.approx(0.0, abs=1e-12)
    assert abs(command.yaw_rate_radps) == pytest.approx(1.2)
    if bearing_deg != 180:
        assert np.sign(command.yaw_rate_radps) == np.sign(bearing_deg)


@pytest.mark.parametrize("path", [[[0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]], [[-2.0, 0.0], [ARRIVED_M / 2, 0.0]]])
def test_arrived_robots_stand_still(path):
    command = command_at(0.0, 0.0, 1.0, np.array(path), 2.0, 0.6, 1.5, start_m=2.0)
    assert (command.v_mps, command.yaw_rate_radps) == (0.0, 0.0)


def test_brakes_towards_the_end():
    for to_end in (0.06, 0.1, 0.3):
        command = command_at(0.0, 0.0, 0.0, np.array([[-1.0, 0.0], [to_end, 0.0]]), 2.0, 0.6, 1.5)
        assert command.v_mps == pytest.approx(math.sqrt(2 * BRAKING_MPS2 * to_end))


CORNER = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])


@pytest.mark.parametrize(
    ("place", "lookahead_m", "ahead"),
    [
        ((1.0, 0.5), 2.0, (1.0 + math.sqrt(4 - 0.25), 0.0)),
        ((1.0, 0.5), 3.5, (4.0, 0.5 + math.sqrt(3.5**2 - 9))),
        ((1.0, 0.5), 50.0, (4.0, 3.0)),
        ((1.0, 5.0), 0.5, (4.0, 3.0)),
        ((1.0, -1.0), 0.5, (1.0, 0.0)),
    ],
)
def test_lookahead_point_is_where_the_circle_meets_the_path_ahead(place, lookahead_m, ahead):
    assert lookahead(CORNER, *place, nearest_on_path(CORNER, *place), lookahead_m, math.inf)[:2] == pytest.approx(ahead)
