"""A robot without a body: told a speed and a yaw rate, it has them at once, and walks nowhere but where they lead."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.disturbances import NONE, Disturbances, DisturbanceSettings
from quadlog.simulation.kinematic import unicycle_step


class UnicycleRobot:
    """Stands in for a WalkingRobot. Of all that disturbs one, only what is wrong with its pose does anything to it."""

    mass_kg = float("nan")
    fallen = False
    effort = None

    def __init__(
        self,
        start_pose: Float,
        tick_s: float,
        rng: np.random.Generator,
        disturbances: DisturbanceSettings = NONE,
    ) -> None:
        self.tick_s, self.ticks = tick_s, 0
        self.disturbances = Disturbances(disturbances, rng)
        self.pose: Float = np.array(start_pose, dtype=np.float64)
        self.velocity = (0.0, 0.0, 0.0)
        self.torques_nm: Float = np.full(12, np.nan)
        self.foot_loads_n: Float = np.full(4, np.nan)

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
        """Go on for so many ticks along the arc of a speed and a yaw rate."""
        x_m, y_m, yaw_rad = self.pose.tolist()
        moved = unicycle_step(x_m, y_m, yaw_rad, speed_mps, yaw_rate_radps, ticks * self.tick_s)
        self.pose = np.array(moved, dtype=np.float64)
        self.velocity = (speed_mps, 0.0, yaw_rate_radps)
        self.ticks += ticks
