"""Pure pursuit: drive the arc that leads through a point of the path some way ahead [Tracking, section 3]."""

from __future__ import annotations

import math
from typing import NamedTuple

from quadlog.following.path import PathPosition, lookahead_point, remaining_length
from quadlog.messages import Float

# Within this of its end the path has been walked.
ARRIVED_M = 0.05
# How hard the robot brakes towards the end of the path.
BRAKING_MPS2 = 0.5
# A look-ahead point farther to the side than this makes the robot slow down, until at 90 degrees it turns on the spot.
SHARP_TURN_RAD = math.pi / 4


class Command(NamedTuple):
    """Forward speed and yaw rate for the robot, and the look-ahead point in map that they lead to."""

    v_mps: float
    yaw_rate_radps: float
    lookahead_x_m: float
    lookahead_y_m: float


def pure_pursuit(
    x_m: float,
    y_m: float,
    yaw_rad: float,
    path: Float,
    near: PathPosition,
    lookahead_m: float,
    speed_mps: float,
    max_yaw_rate_radps: float,
) -> Command:
    """The command for a robot at a pose in map, near being its nearest point of a path (K, 2), K >= 1.

    Curvature 2 y_l / l^2, y_l being how far left the look-ahead point lies and l
    its distance: lookahead_m, less near the path's end. In curves tighter than
    the yaw rate allows the robot goes slower, so it stays on the arc.
    """
    ahead_m = lookahead_point(path, x_m, y_m, near, lookahead_m)
    to_walk_m = remaining_length(path, near.segment, near.fraction)
    return arc_to(x_m, y_m, yaw_rad, ahead_m, path[-1].tolist(), to_walk_m, speed_mps, max_yaw_rate_radps)


def arc_to(
    x_m: float,
    y_m: float,
    yaw_rad: float,
    ahead_m: tuple[float, float],
    end_m: tuple[float, float],
    to_walk_m: float,
    speed_mps: float,
    max_yaw_rate_radps: float,
) -> Command:
    """The command from a pose in map to the look-ahead point, of a path that ends to_walk_m later in end_m."""
    (ahead_x, ahead_y), (end_x, end_y) = ahead_m, end_m
    to_walk = max(to_walk_m, math.hypot(end_x - x_m, end_y - y_m))
    distance = math.hypot(ahead_x - x_m, ahead_y - y_m)
    if to_walk <= ARRIVED_M or distance == 0:
        return Command(0.0, 0.0, ahead_x, ahead_y)

    bearing = math.atan2(ahead_y - y_m, ahead_x - x_m) - yaw_rad
    bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
    # Behind the robot the arc would lead away from the point; it then turns as hard as for one at its side.
    side = math.sin(min(max(bearing, -math.pi / 2), math.pi / 2))
    curvature = 2 * side / distance

    speed = min(speed_mps, math.sqrt(2 * BRAKING_MPS2 * to_walk))
    if abs(curvature) * speed > max_yaw_rate_radps:
        speed = max_yaw_rate_radps / abs(curvature)
    yaw_rate = curvature * speed
    forward = min(max(math.cos(bearing) / math.cos(SHARP_TURN_RAD), 0.0), 1.0)
    return Command(speed * forward, yaw_rate, ahead_x, ahead_y)
