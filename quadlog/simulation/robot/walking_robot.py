"""A simulated quadruped with its controller, commanded by a speed and a yaw rate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from quadlog.compiled import kernel
from quadlog.control.locomotion.body_reference import WantedMotion
from quadlog.control.locomotion.walker import Walker, WalkerSettings
from quadlog.control.locomotion.wbc import WholeBodyState
from quadlog.messages import Float
from quadlog.metrics.walking import Effort
from quadlog.simulation.robot.disturbances import NONE, Disturbances, DisturbanceSettings
from quadlog.simulation.robot.model import QuadrupedModel
from quadlog.simulation.robot.model_files import without_log
from quadlog.simulation.robot.quadruped import Quadruped

# How fast commands may change: pure pursuit's jump where a path begins and bends.
ACCELERATION_MPS2, YAW_ACCELERATION_RADPS2 = 1.0, 4.0
# Lower than this share of its height above its feet, or tilted farther, it has fallen.
FALLEN_HEIGHT_SHARE, FALLEN_TILT_RAD = 0.45, 1.0


class WalkingRobot:
    """One robot on its ground from a start pose (3,) x_m, y_m, yaw_rad on; rng draws what disturbs it."""

    def __init__(
        self,
        model: QuadrupedModel,
        settings: WalkerSettings,
        start_pose: Float,
        rng: np.random.Generator,
        disturbances: DisturbanceSettings = NONE,
    ) -> None:
        self.model = model
        self.tick_s = float(model.model.opt.timestep)
        self.ticks, self._walked = 0, 0
        self._sums: Float = np.zeros(5)
        self.disturbances = Disturbances(disturbances, rng)
        self._settings = replace(settings, mass_error=disturbances.mass_error)
        self.start_at(start_pose)

    def start_at(self, pose: Float) -> None:
        """Stand at a pose (3,), upright and without a step begun; the clock, the effort and the counts go on."""
        self.fallen, self._began = False, self.ticks
        self._quadruped = Quadruped(self.model, *pose.tolist())
        self._state = self._quadruped.read()
        # The state that the controller is given.
        self._estimated = WholeBodyState() if self.disturbances.settings.velocity_bias_mps else self._state
        before, self.walker = getattr(self, "walker", None), Walker(self.model.robot, self._settings, self._state)
        if before is not None:
            self.walker.mpc.counts, self.walker.wbc.counts = before.mpc.counts, before.wbc.counts
            self.walker.wbc.damped = before.wbc.damped
        self.disturbances.poses.clear()
        # Of the tick before, overwritten by the next; loads (4,) are the normal forces on the feet.
        self.torques_nm: Float = np.zeros(12)
        self.foot_loads_n: Float = np.zeros(4)
        self._speed_mps, self._yaw_rate_radps = 0.0, 0.0

    @property
    def mass_kg(self) -> float:
        """True total mass."""
        return self.model.robot.mass_kg

    @property
    def joints(self) -> Float:
        """(nq,) MuJoCo's coordinates now, a copy: what a picture of the robot is drawn from."""
        return self._quadruped.data.qpos.copy()

    @property
    def state(self) -> WholeBodyState:
        """True position, velocities and rotation; overwritten by the next tick."""
        return self._state

    @property
    def t_s(self) -> float:
        """Since the start."""
        return self.ticks * self.tick_s

    @property
    def position_m(self) -> Float:
        """(3,) of the body's origin in map."""
        return self._state.position_m.copy()

    @property
    def pose(self) -> Float:
        """(3,) x_m, y_m, yaw_rad, as they truly are."""
        return np.array([self._state.position_m[0], self._state.position_m[1], self._state.rpy[2]])

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw, as they truly are."""
        roll, pitch, yaw = self._state.rpy.tolist()
        return roll, pitch, yaw

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Forward and left in the body's heading, m/s, and yaw rate, rad/s."""
        vx, vy, _ = self._state.qvel[:3].tolist()
        yaw = self.rpy[2]
        cos, sin = math.cos(yaw), math.sin(yaw)
        yaw_rate = float(self._state.rotation_body_to_map[2] @ self._state.qvel[3:6])
        return cos * vx + sin * vy, cos * vy - sin * vx, yaw_rate

    @property
    def effort(self) -> Effort:
        """Energy, torques and body errors of the walk so far."""
        energy_j, torque_max_nm, cut, pitch_squared, height_squared = self._sums.tolist()
        ticks = max(self._walked, 1)
        rms = (math.sqrt(pitch_squared / ticks), math.sqrt(height_squared / ticks))
        return Effort(energy_j, torque_max_nm, cut / (12 * ticks), *rms)

    @without_log()
    def walk(self, ticks: int, speed_mps: float, yaw_rate_radps: float) -> None:
        """Walk for a number of ticks towards a speed and a yaw rate; a robot that has fallen does not move."""
        for done in range(ticks):
            if self.fallen:
                self.ticks += ticks - done
                return
            self._slew(speed_mps, yaw_rate_radps)
            self._tick(WantedMotion(self._speed_mps, self._yaw_rate_radps), weigh=done == ticks - 1)

    def _slew(self, speed_mps: float, yaw_rate_radps: float) -> None:
        step_mps, step_radps = ACCELERATION_MPS2 * self.tick_s, YAW_ACCELERATION_RADPS2 * self.tick_s
        self._speed_mps += min(max(speed_mps - self._speed_mps, -step_mps), step_mps)
        self._yaw_rate_radps += min(max(yaw_rate_radps - self._yaw_rate_radps, -step_radps), step_radps)

    def _tick(self, wanted: WantedMotion, weigh: bool) -> None:
        quadruped, state, walker = self._quadruped, self._state, self.walker
        if self._estimated is not state:
            np.copyto(self._estimated.record, state.record)
            self._estimated.qvel[:3] += self.disturbances.velocity_bias_mps
        t_s = self.t_s
        walked_s = (self.ticks - self._began) * self.tick_s
        self.torques_nm, cut = walker.step(walked_s, self.tick_s, self._estimated, wanted)
        _sum_up(self._sums, self.torques_nm, cut, state.record, walker.reference.record, self.tick_s)
        quadruped.act(self.torques_nm, self.disturbances.push_at(t_s, float(state.rpy[2])))
        if weigh:
            self.foot_loads_n = quadruped.foot_loads_n()
        self._walked += 1
        self.ticks += 1
        quadruped.read()
        self.fallen = self._lies()

    def _lies(self) -> bool:
        (x, y, z), (a, b, c) = self._state.position_m.tolist(), self.walker.stride.plane.tolist()
        roll, pitch, _ = self._state.rpy.tolist()
        too_low: bool = z - (a * x + b * y + c) < FALLEN_HEIGHT_SHARE * self.model.robot.standing_height_m
        return too_low or max(abs(roll), abs(pitch)) > FALLEN_TILT_RAD


@kernel
def _sum_up(sums, torques, cut, state, reference, tick_s):  # type: ignore[no-untyped-def]
    """Add one tick to the sums behind Effort."""
    now, wanted = state[0], reference[0]
    pitch_error, height_error = now.rpy[1] - wanted.rpy[1], now.position_m[2] - wanted.position_m[2]
    for joint in range(12):
        sums[0] += abs(torques[joint] * now.qvel[6 + joint]) * tick_s
        sums[1] = max(sums[1], abs(torques[joint]))
        sums[2] += cut[joint]
    sums[3] += pitch_error * pitch_error
    sums[4] += height_error * height_error
