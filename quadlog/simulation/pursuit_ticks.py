"""The ticks between two maps: a robot follows one plan, and every tick is written down. Compiled."""

from __future__ import annotations

import math

from numba import njit

from quadlog.following.path import nearest_on_path, point_at_length
from quadlog.following.pure_pursuit import pure_pursuit
from quadlog.simulation.clearance import body_clearance
from quadlog.simulation.kinematic import unicycle_step

# What advance writes for every tick, in this order.
TICK_COLUMNS = (
    "x_m",
    "y_m",
    "yaw_rad",
    "ref_x_m",
    "ref_y_m",
    "cross_track_m",
    "time_error_m",
    "heading_error_rad",
    "cmd_v_mps",
    "cmd_yaw_rate_radps",
    "clearance_m",
)


@njit(cache=True)
def advance(  # type: ignore[no-untyped-def]
    pose, path, since_plan_s, tick_s, pursuit, body, centres_m, cell_m, low_m, high_m, rows
):
    """Fills rows (N, len(TICK_COLUMNS)), moves pose (3,) on, and counts the ticks outside the window.

    path (K, 2): the plan; without one, K = 0, the robot stands. since_plan_s (N,): age of the plan at each tick.
    pursuit: (look-ahead, speed, largest yaw rate). body: (length, width). centres_m (M, 2): the occupied cells.
    low_m, high_m (2,): the window's corners.
    """
    lookahead_m, speed_mps, max_yaw_rate = pursuit
    outside = 0
    for k in range(len(rows)):
        x, y, yaw = pose[0], pose[1], pose[2]
        rows[k, 0], rows[k, 1], rows[k, 2] = x, y, yaw
        v, yaw_rate = 0.0, 0.0
        if len(path) > 0:
            near = nearest_on_path(path, x, y)
            reference_x, reference_y = point_at_length(path, since_plan_s[k] * speed_mps)
            command = pure_pursuit(x, y, yaw, path, lookahead_m, speed_mps, max_yaw_rate)
            v, yaw_rate = command.v_mps, command.yaw_rate_radps
            rows[k, 3], rows[k, 4], rows[k, 5] = near.x_m, near.y_m, near.distance_m
            rows[k, 6] = math.hypot(reference_x - x, reference_y - y)
            rows[k, 7] = yaw - near.heading_rad
        rows[k, 8], rows[k, 9] = v, yaw_rate
        if low_m[0] <= x < high_m[0] and low_m[1] <= y < high_m[1]:
            rows[k, 10] = body_clearance(x, y, yaw, body[0], body[1], centres_m, cell_m)
        else:
            outside += 1
        pose[0], pose[1], pose[2] = unicycle_step(x, y, yaw, v, yaw_rate, tick_s)
    return outside
