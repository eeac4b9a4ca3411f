"""The controller closed over MuJoCo's robot. Whole-body control hides errors of the MPC; FpM, without it, does not."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from quadlog.control.locomotion.body_reference import slope_angles
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import Walker, WalkerSettings
from quadlog.messages import Float
from quadlog.simulation.robot.height_field import flat, slope
from quadlog.simulation.robot.model import QuadrupedModel, quadruped_model
from quadlog.simulation.robot.quadruped import Quadruped

ROBOT = ROBOTS["tracking"]
FPM = WalkerSettings(whole_body=False)
SETTLED_S = 1.0


class Walk(NamedTuple):
    """A row per tick: positions_m (T, 3), rpy (T, 3) with yaw unwrapped, velocities_mps (T, 3) and settled.

    Settled are the ticks from which on it walks as fast as it is told; speed_mps is the mean along the heading, over
    the ground, of these, off_m their heights less the wanted ones.
    """

    positions_m: Float
    rpy: Float
    velocities_mps: Float
    off_m: Float
    settled: slice
    speed_mps: float
    cut: int
    walker: Walker


@pytest.fixture(scope="module")
def level() -> QuadrupedModel:
    return quadruped_model(ROBOT, flat())


def walk(
    model: QuadrupedModel,
    seconds: float,
    speed_mps: float,
    yaw_rate_radps: float = 0.0,
    settings: WalkerSettings = FPM,
    yaw_rad: float = 0.0,
    push_n: tuple[float, float, float] | None = None,
) -> Walk:
    """From standing; push_n: on the trunk, amid the first second, for 0.1 s."""
    quadruped, dt_s = Quadruped(model, 0.0, 0.0, yaw_rad), float(model.model.opt.timestep)
    state = quadruped.read()
    walker = Walker(model.robot, settings, state)
    rows, cut = [], 0
    for tick in range(round(seconds / dt_s)):
        t_s = tick * dt_s
        torques_nm = walker.step(t_s, dt_s, state, (speed_mps, 0.0, yaw_rate_radps))
        rows.append([*state.position_m, *state.rpy, *state.qvel[:3], walker.reference.position_m[2]])
        cut += int(walker.wbc.saturated.sum())
        pushed = push_n is not None and 0.6 <= t_s < 0.7
        quadruped.act(torques_nm, np.array(push_n) if pushed else None)
        quadruped.read()
    columns = np.array(rows)
    columns[:, 5] = np.unwrap(columns[:, 5])
    settled = slice(round(SETTLED_S / dt_s), None)
    vx, vy, vz = columns[settled, 6:9].T
    yaw = columns[settled, 5]
    forward = float(np.mean(np.cos(yaw) * vx + np.sin(yaw) * vy))
    speed = math.hypot(forward, float(vz.mean())) * math.copysign(1, forward)
    off_m = columns[settled, 2] - columns[settled, 9]
    return Walk(columns[:, :3], columns[:, 3:6], columns[:, 6:9], off_m, settled, speed, cut, walker)


@pytest.mark.parametrize(("whole_body", "height_m"), [(True, 0.01), (False, 0.012)])
@pytest.mark.parametrize("yaw_rate_radps", [0.0, 0.3, -0.3])
def test_it_walks_as_told(level, yaw_rate_radps, whole_body, height_m):
    walked = walk(level, 3.0, 0.5, yaw_rate_radps, WalkerSettings(whole_body=whole_body))
    assert walked.speed_mps == pytest.approx(0.5, rel=0.05)
    yaw_rad = walked.rpy[walked.settled, 2]
    assert (yaw_rad[-1] - yaw_rad[0]) / 2 == pytest.approx(yaw_rate_radps, abs=0.015 if whole_body else 0.02)
    assert np.degrees(np.abs(walked.rpy[walked.settled, :2])).max() < 3
    assert np.abs(walked.off_m).max() < height_m
    assert abs(walked.off_m.mean()) < 0.005
    if not whole_body:
        return
    assert walked.positions_m[walked.settled, 2] == pytest.approx(ROBOT.standing_height_m, abs=0.015)
    assert walked.cut == 0
    counts = walked.walker.counts
    assert counts["mpc_solves"] > 100
    assert counts["mpc_failed"] == counts["wbc_failed"] == 0
    if yaw_rate_radps == 0:
        assert abs(walked.positions_m[-1, 1]) < 0.01


@pytest.mark.parametrize("whole_body", [True, False])
@pytest.mark.parametrize("angle_deg", [10.0, -10.0])
def test_up_and_down_hill_it_walks_along_the_ground(whole_body, angle_deg):
    hill = quadruped_model(ROBOT, slope(math.radians(angle_deg)))
    walked = walk(hill, 2.5, 0.5, settings=WalkerSettings(whole_body=whole_body))
    assert walked.speed_mps == pytest.approx(0.5, rel=0.05)
    roll, pitch, _ = np.degrees(walked.rpy[walked.settled]).T
    assert np.abs(roll).max() < 2
    assert np.abs(pitch + angle_deg).max() < 3
    assert np.abs(walked.off_m).max() < 0.01
    assert walked.positions_m[-1, 2] - walked.positions_m[0, 2] == pytest.approx(
        math.tan(math.radians(angle_deg)) * walked.positions_m[-1, 0], abs=0.015
    )
    assert slope_angles(walked.walker.stride.plane, 0.0)[1] == pytest.approx(-math.radians(angle_deg), abs=0.02)


# Pushed to its limits, whole-body control tells the quarters apart: the sides of its pyramids lie along map's axes.
@pytest.mark.parametrize(
    ("whole_body", "turned_deg", "push_n"),
    [
        (True, 137.0, None),
        (True, 90.0, (-40.0, 100.0, 0.0)),
        (False, 137.0, None),
        (False, 137.0, (-40.0, 100.0, 0.0)),
    ],
)
def test_in_a_turned_world_it_walks_the_same(level, whole_body, turned_deg, push_n):
    settings, turned_rad = WalkerSettings(whole_body=whole_body), math.radians(turned_deg)
    cos, sin = math.cos(turned_rad), math.sin(turned_rad)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    walked = walk(level, 1.2, 0.5, 0.3, settings, push_n=push_n)
    elsewhere = walk(level, 1.2, 0.5, 0.3, settings, turned_rad, push_n and tuple(turn @ push_n))
    back = elsewhere.positions_m @ turn
    np.testing.assert_allclose(back, walked.positions_m, atol=1e-3)
    np.testing.assert_allclose(elsewhere.rpy - walked.rpy, np.tile([0, 0, turned_rad], (len(walked.rpy), 1)), atol=5e-3)


def test_pushed_aside_it_goes_on_upright(level):
    walked = walk(level, 2.5, 0.5, settings=WalkerSettings(), push_n=(0.0, 60.0, 0.0))
    moved_m = float(np.abs(walked.positions_m[:, 1]).max())
    assert 0.01 < moved_m < 0.3
    assert np.abs(walked.velocities_mps[-220:, 1].mean()) < 0.05
    assert np.degrees(np.abs(walked.rpy[-400:, :2]).max()) < 3
