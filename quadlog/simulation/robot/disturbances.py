"""Disturbances of a simulated robot: pushes, errors of its sensors, and errors of its mass model."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.settings import DisturbanceSettings

NONE = DisturbanceSettings()
DISTURBED = DisturbanceSettings(
    push_n=60.0, velocity_bias_mps=0.03, pose_noise_m=0.03, pose_lag_s=0.1, mass_error=-0.08
)
"""What `quadlog simulate --disturbed` means."""
HEADING_ARM_M = 0.5
"""The heading is as noisy as the place that far ahead would be."""


class Disturbances:
    """Draws from one generator, in the order of the ticks."""

    def __init__(self, settings: DisturbanceSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self._rng = rng
        angle_rad = rng.uniform(0, 2 * math.pi)
        self.velocity_bias_mps: Float = settings.velocity_bias_mps * np.array(
            [math.cos(angle_rad), math.sin(angle_rad), 0.0]
        )
        self._next_push_s = settings.push_every_s
        self._side = self._left_or_right()
        self.poses: deque[tuple[float, Float]] = deque()

    def push_at(self, t_s: float, rpy: Float) -> Float | None:
        """The force (3,) in map on a trunk that is turned by rpy (3,), at an instant; None for none."""
        settings = self.settings
        if settings.push_n == 0 or t_s < self._next_push_s:
            return None
        if t_s >= self._next_push_s + settings.push_s:
            self._next_push_s += settings.push_every_s
            self._side = self._left_or_right()
            return None
        force_n = self._side * settings.push_n
        return np.array([-math.sin(rpy[2]) * force_n, math.cos(rpy[2]) * force_n, 0.0])

    def _left_or_right(self) -> float:
        return 1.0 if self._rng.random() < 0.5 else -1.0

    def measured(self, t_s: float, pose: Float) -> Float:
        """The pose (3,) x_m, y_m, yaw_rad that is known at t_s, of the true one at that instant; call at every step."""
        settings = self.settings
        if settings.pose_noise_m == 0 and settings.pose_lag_s == 0:
            return pose
        noise = self._rng.normal(0.0, 1.0, 3) * settings.pose_noise_m
        noise[2] /= HEADING_ARM_M
        self.poses.append((t_s, pose + noise))
        # What was measured a lag ago is known now; half a microsecond for the rounding of times.
        while len(self.poses) > 1 and self.poses[1][0] <= t_s - settings.pose_lag_s + 5e-7:
            self.poses.popleft()
        return self.poses[0][1]
