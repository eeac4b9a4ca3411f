"""The ticks between two maps: a robot follows one plan, and every tick is written down."""

from __future__ import annotations

import math

from quadlog.following.path import nearest_on_path, points_at_lengths
from quadlog.following.pure_pursuit import pure_pursuit
from quadlog.messages import Float
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


def advance(
    pose: Float,
    path: Float,
    since_plan_s: Float,
    tick_s: float,
    pursuit: tuple[float, float, float],
    body: tuple[float, float],
    centres_m: Float,
    cell_m: float,
    low_m: Float,
    high_m: Float,
    rows: Float,
) -> int:
    """Fills rows (N, len(TICK_COLUMNS)), moves pose (3,) on, and counts the ticks outside the window.

    path (K, 2): the plan; without one, K = 0, the robot stands. since_plan_s (N,): age of the plan at each tick.
    pursuit: (look-ahead, speed, largest yaw rate). body: (length, width). centres_m (M, 2): the occupied cells.
    low_m, high_m (2,): the window's corners.
    """
    lookahead_m, speed_mps, max_yaw_rate = pursuit
    (low_x, low_y), (high_x, high_y) = low_m.tolist(), high_m.tolist()
    references_m = points_at_lengths(path, since_plan_s * speed_mps).tolist() if len(path) else []
    outside = 0
    x, y, yaw = pose.tolist()
    for k, row in enumerate(rows):
        row[:3] = x, y, yaw
        v, yaw_rate = 0.0, 0.0
        if len(path) > 0:
            near = nearest_on_path(path, x, y)
            reference_x, reference_y = references_m[k]
            command = pure_pursuit(x, y, yaw, path, near, lookahead_m, speed_mps, max_yaw_rate)
            v, yaw_rate = command.v_mps, command.yaw_rate_radps
            away_m = math.hypot(reference_x - x, reference_y - y)
            row[3:8] = near.x_m, near.y_m, near.distance_m, away_m, yaw - near.heading_rad
        row[8:10] = v, yaw_rate
        if low_x <= x < high_x and low_y <= y < high_y:
            row[10] = body_clearance(x, y, yaw, body[0], body[1], centres_m, cell_m)
        else:
            outside += 1
        x, y, yaw = unicycle_step(x, y, yaw, v, yaw_rate, tick_s)
    pose[:] = x, y, yaw
    return outside
