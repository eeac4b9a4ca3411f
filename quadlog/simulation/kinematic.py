"""A robot that does exactly what it is told: the unicycle, integrated without error."""

from __future__ import annotations

import math


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
