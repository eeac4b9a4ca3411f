"""A site's walk as a simulated quadruped really walks it: the poses of its body, what an IMU measures, its joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.control.locomotion.robot import ROBOTS, Robot
from quadlog.errors import QuadlogError
from quadlog.geometry import wrap_angle
from quadlog.messages import GRAVITY_MPS2, NS_PER_S, Float, JointStates
from quadlog.simulation.robot.height_field import FLAT, HeightField
from quadlog.simulation.sensors.trajectory import Motion, Walk, turned_from_level

if TYPE_CHECKING:
    from quadlog.simulation.robot.walking_robot import WalkingRobot

TICK_NS = 2_000_000
_TICK_S = TICK_NS / NS_PER_S
CONTROL_TICKS = 10
IMU_MEAN_S = 0.01
GAIN_AHEAD_1PS, GAIN_ASIDE_1PM2, GAIN_TURN_1PM = 0.8, 4.0, 3.0
"""Of the tracking law, ours: for .3 to .8 m/s."""
MOST_MPS, MOST_RADPS = 1.0, 1.5
_SIGNS = np.tile([1.0, -1.0, -1.0], 4)
"""From quadlog's joints, whose thigh and calf turn about -y, to those of messages."""

_ROW = np.dtype(
    [
        *((name, "f8", 3) for name in ("position_m", "rpy_rad", "velocity_mps", "omega_radps")),
        *((name, "f4", 12) for name in ("joints_rad", "joints_radps", "torques_nm")),
        ("foot_loads_n", "f4", 4),
    ]
)
"""A tick: base's place and attitude in map; the trunk's velocity in map and rotation about its own axes; the joints as
quadlog.control.locomotion has them; torques and loads are those of the tick before."""


@dataclass(frozen=True, eq=False)
class LeggedWalk:
    """A walk (see Walk) by a walker that follows `wanted` in time over a terrain; simulated when first needed.

    Its base is fixed to the trunk, on the ground under its centre when it stands: mounts and tags are as high above
    base as those of a robot without a body. duration_s: from the start; later it stays where it was.
    """

    wanted: Walk
    duration_s: float
    terrain: HeightField = FLAT
    robot: Robot = field(default_factory=lambda: ROBOTS["tracking"])

    def at(self, t_s: Float) -> Motion:
        """See Walk."""
        x_m, y_m, z_m, roll, pitch, yaw, ahead_mps, ahead_mps2, turn_radps = self._at(self._motion, t_s)
        place_m = np.column_stack([x_m, y_m])
        return Motion(place_m, wrap_angle(yaw), ahead_mps, ahead_mps2, turn_radps, z_m, roll, pitch)

    def inertial(self, t_s: Float) -> tuple[Float, Float]:
        """See Walk: of an IMU in the trunk's centre that takes its acceleration's mean over IMU_MEAN_S."""
        omega_radps = self._at(self._rates[3:], t_s).T
        after, before = (self._at(self._rates[:3], t_s + each_s) for each_s in (IMU_MEAN_S / 2, -IMU_MEAN_S / 2))
        x, y, z = (after - before) / IMU_MEAN_S
        motion = self.at(t_s)
        cos, sin = np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)
        level_mps2 = np.column_stack([cos * x + sin * y, cos * y - sin * x, z + GRAVITY_MPS2])
        return omega_radps, turned_from_level(motion, level_mps2)

    def joint_messages(self, start_ns: int, end_ns: int) -> Iterator[JointStates]:
        """One per tick before end_ns, free of sensor errors, in the conventions of messages."""
        for row, stamp_ns in zip(self.rows, range(start_ns, end_ns, TICK_NS), strict=False):
            position, velocity, torque = (_SIGNS * row[name] for name in ("joints_rad", "joints_radps", "torques_nm"))
            yield JointStates(stamp_ns, position, velocity, torque, row["foot_loads_n"].astype(np.float64))

    @cached_property
    def rows(self) -> NDArray[np.void]:
        """(N,) _ROW of every tick: the simulated walk. Raises QuadlogError where it falls."""
        from quadlog.control.locomotion.walker import WalkerSettings
        from quadlog.simulation.robot.model import quadruped_model
        from quadlog.simulation.robot.walking_robot import WalkingRobot

        t_s = np.arange(math.ceil(self.duration_s * NS_PER_S / TICK_NS) + 1) * _TICK_S
        wanted = self.wanted.at(t_s)
        start_pose = np.array([*wanted.position_m[0], wanted.yaw_rad[0]])
        model = quadruped_model(self.robot, self.terrain)
        walker = WalkingRobot(model, WalkerSettings(), start_pose, np.random.default_rng(0))
        rows = np.zeros(len(t_s), _ROW)
        _write(rows[0], walker)
        for tick in range(1, len(t_s)):
            if tick % CONTROL_TICKS == 1:
                command = _command(walker.pose, wanted, tick)
            walker.walk(1, *command)
            _write(rows[tick], walker)
            if walker.fallen:
                x_m, y_m = walker.pose[:2]
                raise QuadlogError(
                    f"the walker fell after {t_s[tick]:.1f} s at ({x_m:.1f}, {y_m:.1f}) m; take another --seed"
                )
        rows["rpy_rad"][:, 2] = np.unwrap(rows["rpy_rad"][:, 2])
        return rows

    @cached_property
    def _motion(self) -> Float:
        """(9, N) what `at` tells, the yaw without jumps."""
        rows = self.rows
        yaw_rad, (vx_mps, vy_mps, _) = rows["rpy_rad"][:, 2], rows["velocity_mps"].T
        ahead_mps = np.cos(yaw_rad) * vx_mps + np.sin(yaw_rad) * vy_mps
        rates = [ahead_mps, np.gradient(ahead_mps, _TICK_S), np.gradient(yaw_rad, _TICK_S)]
        return np.stack([*rows["position_m"].T, *rows["rpy_rad"].T, *rates])

    @cached_property
    def _rates(self) -> Float:
        """(6, N) the trunk's velocity in map, and its angular velocity in base."""
        return np.stack([*self.rows["velocity_mps"].T, *self.rows["omega_radps"].T])

    def _at(self, series: Float, t_s: Float) -> Float:
        """(K, M) of series (K, N) at M instants."""
        known_s = np.arange(series.shape[1]) * _TICK_S
        return np.stack([np.interp(t_s, known_s, each) for each in series])


def _write(row: Any, walker: WalkingRobot) -> None:
    state, model = walker.state, walker.model
    height_m = model.robot.standing_height_m
    row["position_m"] = state.position_m - height_m * state.rotation_body_to_map[:, 2]
    row["rpy_rad"] = state.rpy
    row["velocity_mps"], row["omega_radps"], row["joints_radps"] = np.split(state.qvel, [3, 6])
    row["joints_rad"] = walker.joints[model.joint_qpos]
    row["torques_nm"], row["foot_loads_n"] = walker.torques_nm, walker.foot_loads_n


def _command(pose: Float, wanted: Motion, tick: int) -> tuple[float, float]:
    """Speed and yaw rate that bring a pose (3,) to where it is wanted at a tick [Kanayama]."""
    x_m, y_m, yaw_rad = pose.tolist()
    (to_x_m, to_y_m), turn_rad = wanted.position_m[tick].tolist(), float(wanted.yaw_rad[tick]) - yaw_rad
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    ahead_m = cos * (to_x_m - x_m) + sin * (to_y_m - y_m)
    aside_m = cos * (to_y_m - y_m) - sin * (to_x_m - x_m)
    speed_mps, turn_radps = float(wanted.speed_mps[tick]), float(wanted.yaw_rate_radps[tick])
    wanted_mps = speed_mps * math.cos(turn_rad) + GAIN_AHEAD_1PS * ahead_m
    wanted_radps = turn_radps + speed_mps * (GAIN_ASIDE_1PM2 * aside_m + GAIN_TURN_1PM * math.sin(turn_rad))
    return min(max(wanted_mps, 0.0), MOST_MPS), min(max(wanted_radps, -MOST_RADPS), MOST_RADPS)
