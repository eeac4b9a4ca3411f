"""A kinematic robot without a body: it has a commanded speed and yaw rate at once and moves along their arc."""

from __future__ import annotations

import math

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.robot.disturbances import NONE, Disturbances
from quadlog.simulation.settings import DisturbanceSettings


def unicycle_step(
    x_m: float, y_m: float, yaw_rad: float, v_mps: float, yaw_rate_radps: float, duration_s: float
) -> tuple[float, float, float]:
    """(x_m, y_m, yaw_rad in [-pi, pi)) after moving for duration_s at constant speed and yaw rate: an exact arc.

    The arc's chord, v t sin(a)/a with a = yaw rate t / 2, points along yaw + a. In
    this form a straight line is no special case: sin(a)/a tends to 1.
    """
    half_turn = 0.5 * yaw_rate_radps * duration_s
    chord = v_mps * duration_s
    if half_turn != 0:
        chord *= math.sin(half_turn) / half_turn
    along = yaw_rad + half_turn
    turned = (yaw_rad + 2 * half_turn + math.pi) % (2 * math.pi) - math.pi
    return x_m + chord * math.cos(along), y_m + chord * math.sin(along), turned


class UnicycleRobot:
    """Has the interface of WalkingRobot. Of the disturbances only the pose errors affect it."""

    mass_kg = float("nan")
    fallen = False
    effort = None
    step_us = float("nan"), float("nan")

    def __init__(
        self,
        start_pose: Float,
        tick_s: float,
        rng: np.random.Generator,
        disturbances: DisturbanceSettings = NONE,
    ) -> None:
        self.tick_s, self.ticks = tick_s, 0
        self.disturbances = Disturbances(disturbances, rng)
        self.start_at(start_pose)
        self.torques_nm: Float = np.full(12, np.nan)
        self.foot_loads_n = self.wanted_loads_n = np.full(4, np.nan)

    def start_at(self, pose: Float) -> None:
        """Stand at a pose (3,); the clock goes on."""
        self.pose: Float = np.array(pose, dtype=np.float64)
        self.velocity = (0.0, 0.0, 0.0)
        self.disturbances.poses.clear()

    @property
    def t_s(self) -> float:
        """Since the start."""
        return self.ticks * self.tick_s

    @property
    def position_m(self) -> Float:
        """(3,) in map; it has no height."""
        return np.array([self.pose[0], self.pose[1], np.nan])

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Its yaw; it does not tilt."""
        return float("nan"), float("nan"), float(self.pose[2])

    def walk(self, ticks: int, speed_mps: float, yaw_rate_radps: float) -> None:
        """Move for a number of ticks along the arc of a speed and a yaw rate."""
        x_m, y_m, yaw_rad = self.pose.tolist()
        moved = unicycle_step(x_m, y_m, yaw_rad, speed_mps, yaw_rate_radps, ticks * self.tick_s)
        self.pose = np.array(moved, dtype=np.float64)
        self.velocity = (speed_mps, 0.0, yaw_rate_radps)
        self.ticks += ticks
