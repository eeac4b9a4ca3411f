"""Where a robot is beside its path, and what lies ahead on it. Compiled: asked at every tick of a controller."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from quadlog.messages import Float


class PathPosition(NamedTuple):
    """The point of a path nearest to the robot.

    segment: it lies between points `segment` and `segment + 1`; 0 for a path of one point.
    fraction: how far between them, 0..1.
    x_m, y_m: the point; distance_m: signed, positive when the robot is left of the path.
    heading_rad: where the path goes there; NaN when it is a single point and goes nowhere.
    """

    segment: int
    fraction: float
    x_m: float
    y_m: float
    distance_m: float
    heading_rad: float


@njit(cache=True)
def nearest_on_path(path: Float, x_m: float, y_m: float) -> PathPosition:
    """The nearest point of a polyline (K, 2); among equals the first. Repeated points and K = 1 are fine."""
    best, best_fraction, best_squared = 0, 0.0, math.inf
    for i in range(max(len(path) - 1, 1)):
        j = min(i + 1, len(path) - 1)
        dx, dy = path[j, 0] - path[i, 0], path[j, 1] - path[i, 1]
        squared_length = dx * dx + dy * dy
        fraction = 0.0
        if squared_length > 0:
            fraction = ((x_m - path[i, 0]) * dx + (y_m - path[i, 1]) * dy) / squared_length
            fraction = min(max(fraction, 0.0), 1.0)
        away_x, away_y = path[i, 0] + fraction * dx - x_m, path[i, 1] + fraction * dy - y_m
        squared = away_x * away_x + away_y * away_y
        if squared < best_squared:
            best, best_fraction, best_squared = i, fraction, squared
    j = min(best + 1, len(path) - 1)
    dx, dy = path[j, 0] - path[best, 0], path[j, 1] - path[best, 1]
    near_x, near_y = path[best, 0] + best_fraction * dx, path[best, 1] + best_fraction * dy
    heading = segment_heading(path, best)
    distance = math.sqrt(best_squared)
    if math.cos(heading) * (y_m - near_y) - math.sin(heading) * (x_m - near_x) < 0:
        distance = -distance
    return PathPosition(best, best_fraction, near_x, near_y, distance, heading)


@njit(cache=True)
def segment_heading(path: Float, segment: int) -> float:
    """Direction in radians of a segment, or of the nearest one that has a length; NaN if none has."""
    last = len(path) - 2
    for offset in range(last + 1):
        for i in (segment + offset, segment - offset):
            if 0 <= i <= last:
                dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
                if dx != 0 or dy != 0:
                    return math.atan2(dy, dx)
    return math.nan


@njit(cache=True)
def remaining_length(path: Float, segment: int, fraction: float) -> float:
    """Metres along the path (K, 2) from a point on it to its end."""
    length = 0.0
    for i in range(segment, len(path) - 1):
        step = math.hypot(path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1])
        length += step * (1 - fraction) if i == segment else step
    return length


@njit(cache=True)
def point_at_length(path: Float, length_m: float) -> tuple[float, float]:
    """The point so far along the path (K, 2) from its start; its end beyond that."""
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        step = math.hypot(dx, dy)
        if length_m <= step and step > 0:
            return path[i, 0] + dx * length_m / step, path[i, 1] + dy * length_m / step
        length_m -= step
    return path[-1, 0], path[-1, 1]


@njit(cache=True)
def lookahead_point(path: Float, x_m: float, y_m: float, near: PathPosition, lookahead_m: float) -> tuple[float, float]:
    """The first point of the path, from the nearest one on, that is lookahead_m away from the robot.

    The end of the path when it ends nearer than that; the nearest point itself when that is farther already.
    """
    start_x, start_y = near.x_m, near.y_m
    if math.hypot(start_x - x_m, start_y - y_m) >= lookahead_m:
        return start_x, start_y
    for i in range(near.segment + 1, len(path)):
        end_x, end_y = path[i, 0], path[i, 1]
        if math.hypot(end_x - x_m, end_y - y_m) >= lookahead_m:
            # |start + s d - robot| = l, from inside the circle to outside: one root in 0..1.
            dx, dy = end_x - start_x, end_y - start_y
            from_x, from_y = start_x - x_m, start_y - y_m
            a, b = dx * dx + dy * dy, from_x * dx + from_y * dy
            c = from_x * from_x + from_y * from_y - lookahead_m * lookahead_m
            s = (-b + math.sqrt(max(b * b - a * c, 0.0))) / a
            return start_x + s * dx, start_y + s * dy
        start_x, start_y = end_x, end_y
    return path[-1, 0], path[-1, 1]
