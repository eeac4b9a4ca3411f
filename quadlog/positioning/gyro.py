"""Yaw from an IMU that gives no orientation: its rate about the vertical summed up, its bias left to the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.course import HOLD_BELOW_MPS
from quadlog.positioning.heading import (
    AlignedHeading,
    CausalHeading,
    align_yaw,
    align_yaw_causally,
)
from quadlog.positioning.tracker import Track
from quadlog.positioning.yaw_fit import SensorDrift

GYRO_DRIFT = SensorDrift(rate_std_radps=0.02, walk_std=0.001)
"""Turn-on biases of consumer gyroscopes are about a degree a second, their noise a few hundredths per root second."""
CLEARLY_LESS = 0.5
"""A sign is taken for turned only where the fit then spreads by this much less: a straight walk tells no sign."""


@dataclass(frozen=True, slots=True)
class GyroHeading:
    """Yaw aligned to the course, and whether the IMU turned out to be mounted upside down."""

    heading: AlignedHeading
    upside_down: bool


def integrate_yaw_rate(t_ns: Int, rate_radps: Float) -> Float:
    """(M,) yaw since the first instant, not wrapped, from rates (M,) at increasing t_ns, by trapezoids."""
    t_s = seconds_since(t_ns, int(t_ns[0]) if len(t_ns) else 0)
    steps = np.diff(t_s) * (rate_radps[1:] + rate_radps[:-1]) / 2
    return np.concatenate([np.zeros(min(len(t_ns), 1)), np.cumsum(steps)])


def align_gyro(
    track: Track, t_ns: Int, rate_radps: Float, tag_ahead_m: float = 0.0, hold_below_mps: float = HOLD_BELOW_MPS
) -> GyroHeading:
    """align_yaw for the rate (M,) about the IMU's z axis, which may point up or down: offset, bias and sign are fitted.

    The std grows away from the motion as that of the bias says.
    """
    yaw_rad = integrate_yaw_rate(t_ns, rate_radps)
    up, down = (align_yaw(track, t_ns, sign * yaw_rad, tag_ahead_m, hold_below_mps, GYRO_DRIFT) for sign in (1.0, -1.0))
    turned = down.spread_rad < CLEARLY_LESS * up.spread_rad
    return GyroHeading(down if turned else up, turned)


def align_gyro_causally(
    track: Track, t_ns: Int, rate_radps: Float, tag_ahead_m: float = 0.0, hold_below_mps: float = HOLD_BELOW_MPS
) -> CausalHeading:
    """align_gyro as it was known at each instant, the sign too."""
    yaw_rad = integrate_yaw_rate(t_ns, rate_radps)
    up, down = (
        align_yaw_causally(track, t_ns, sign * yaw_rad, tag_ahead_m, hold_below_mps, GYRO_DRIFT) for sign in (1.0, -1.0)
    )
    turned = down.spread_rad < CLEARLY_LESS * up.spread_rad
    return CausalHeading(
        np.where(turned, down.yaw_rad, up.yaw_rad),
        np.where(turned, down.yaw_std_rad, up.yaw_std_rad),
        np.where(turned, down.spread_rad, up.spread_rad),
    )
