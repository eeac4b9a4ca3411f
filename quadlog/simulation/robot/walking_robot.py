"""A simulated quadruped with its controller, commanded by a speed and a yaw rate."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from quadlog.compiled import kernel
from quadlog.control.locomotion.walker import Walker, WalkerSettings
from quadlog.messages import Float
from quadlog.metrics.walking import Effort
from quadlog.simulation.robot.disturbances import NONE, Disturbances
from quadlog.simulation.robot.model import QuadrupedModel
from quadlog.simulation.robot.model_files import without_log
from quadlog.simulation.robot.quadruped import Quadruped
from quadlog.simulation.settings import DisturbanceSettings

# Lower than this share of its height above its feet, or tilted farther, it has fallen.
FALLEN_HEIGHT_SHARE, FALLEN_TILT_RAD = 0.45, 1.0


class WalkingRobot:
    """One robot on its ground from a start pose (3,) x_m, y_m, yaw_rad on; rng draws what disturbs it.

    mass_kg: its true total mass. state: where the body is, as its controller knows it, and its true velocity;
    overwritten by the next tick.
    """

    def __init__(
        self,
        model: QuadrupedModel,
        settings: WalkerSettings,
        start_pose: Float,
        rng: np.random.Generator,
        disturbances: DisturbanceSettings = NONE,
    ) -> None:
        self.model, self.mass_kg = model, model.robot.mass_kg
        self.tick_s = float(model.model.opt.timestep)
        self.ticks, self._walked, self._counted = 0, 0, Counter[str]()
        self._sums: Float = np.zeros(5)
        self._fallen_m = FALLEN_HEIGHT_SHARE * model.robot.standing_height_m
        self.disturbances = Disturbances(disturbances, rng)
        self._settings = replace(settings, mass_error=disturbances.mass_error)
        self.start_at(start_pose)

    def start_at(self, pose: Float) -> None:
        """Stand at a pose (3,), upright and without a step begun; the clock, the effort and the counts go on."""
        self.fallen, self._began = False, self.ticks
        x_m, y_m, yaw_rad = pose.tolist()
        self._quadruped = Quadruped(self.model, x_m, y_m, yaw_rad, self.disturbances.velocity_bias_mps)
        self.state = self._quadruped.read()
        if self._walked:
            self._counted.update(self.walker.counts)
        self.walker: Walker = Walker(self.model.robot, self._settings, self.state)
        self.disturbances.poses.clear()
        # Of the tick before, overwritten by the next; loads (4,) are the normal forces on the feet, and the MPC's.
        self.torques_nm: Float = self.walker.wbc.torques_nm
        self.foot_loads_n: Float = np.zeros(4)
        self.wanted_loads_n: Float = np.full(4, np.nan)
        self._steps_s: list[float] = []

    @property
    def joints(self) -> Float:
        """(nq,) MuJoCo's coordinates now, a copy: what a picture of the robot is drawn from."""
        return self._quadruped.data.qpos.copy()

    @property
    def t_s(self) -> float:
        """Since the start."""
        return self.ticks * self.tick_s

    @property
    def position_m(self) -> Float:
        """(3,) of the body's origin in map."""
        return self.state.position_m.copy()

    @property
    def pose(self) -> Float:
        """(3,) x_m, y_m, yaw_rad, as they truly are."""
        return np.array([self.state.position_m[0], self.state.position_m[1], self.state.rpy[2]])

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw, as they truly are."""
        roll, pitch, yaw = self.state.rpy.tolist()
        return roll, pitch, yaw

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Forward and left in the body's heading, m/s, and yaw rate, rad/s."""
        vx, vy, _ = self.state.velocity_mps.tolist()
        yaw, up, omega = self.rpy[2], self.state.rotation_body_to_map[2].tolist(), self.state.qvel[3:6].tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        return cos * vx + sin * vy, cos * vy - sin * vx, up[0] * omega[0] + up[1] * omega[1] + up[2] * omega[2]

    @property
    def step_us(self) -> tuple[float, float]:
        """Median and longest time of a controller's step in the last walk; NaN before it."""
        steps_us = [1e6 * each_s for each_s in sorted(self._steps_s)] or [math.nan]
        return steps_us[(len(steps_us) - 1) // 2], steps_us[-1]

    @property
    def counts(self) -> dict[str, int]:
        """Of its controllers' QPs, see Walker."""
        return dict(Counter(self._counted) + Counter(self.walker.counts))

    @property
    def effort(self) -> Effort:
        """Energy, torques and body errors of the walk so far."""
        energy_j, torque_max_nm, cut, pitch_squared, height_squared = self._sums.tolist()
        ticks = max(self._walked, 1)
        rms = (math.sqrt(pitch_squared / ticks), math.sqrt(height_squared / ticks))
        return Effort(energy_j, torque_max_nm, cut / (12 * ticks), *rms)

    @without_log()
    def walk(self, ticks: int, speed_mps: float, yaw_rate_radps: float, left_mps: float = 0.0) -> None:
        """Walk for a number of ticks towards a twist; a robot that has fallen does not move."""
        twist = float(speed_mps), float(left_mps), float(yaw_rate_radps)
        self._steps_s = []
        for done in range(ticks):
            if self.fallen:
                self.ticks += ticks - done
                return
            self._tick(twist, weigh=done == ticks - 1)

    def _tick(self, twist: tuple[float, float, float], weigh: bool) -> None:
        quadruped, state, walker, tick_s = self._quadruped, self.state, self.walker, self.tick_s
        walked_s = (self.ticks - self._began) * tick_s
        torques_nm = walker.step(walked_s, tick_s, state, twist)
        _sum_up(self._sums, walker.wbc.record, state.record, walker.reference.record, tick_s)
        quadruped.act(torques_nm, self.disturbances.push_at(self.t_s, state.rpy))
        if weigh:
            self.foot_loads_n, self.wanted_loads_n = quadruped.foot_loads_n(), walker.wanted_loads_n
        self._steps_s.append(walker.took_s)
        self._walked += 1
        self.ticks += 1
        quadruped.read()
        self.fallen = _lies(state.record, walker.stride.record, self._fallen_m)


@kernel
def _lies(state, stride, least_m):  # type: ignore[no-untyped-def]
    """Whether the body is tilted too far, or lower above the plane of its feet than least_m."""
    now, plane = state[0], stride[0].plane
    height_m = now.position_m[2] - (plane[0] * now.position_m[0] + plane[1] * now.position_m[1] + plane[2])
    return not (height_m >= least_m and max(abs(now.rpy[0]), abs(now.rpy[1])) <= FALLEN_TILT_RAD)


@kernel
def _sum_up(sums, control, state, reference, tick_s):  # type: ignore[no-untyped-def]
    """Add one tick to the sums behind Effort."""
    now, wanted, torques, cut = state[0], reference[0], control[0].torques_nm, control[0].saturated
    pitch_error, height_error = now.rpy[1] - wanted.rpy[1], now.position_m[2] - wanted.position_m[2]
    for joint in range(12):
        sums[0] += abs(torques[joint] * now.qvel[6 + joint]) * tick_s
        sums[1] = max(sums[1], abs(torques[joint]))
        sums[2] += cut[joint]
    sums[3] += pitch_error * pitch_error
    sums[4] += height_error * height_error
