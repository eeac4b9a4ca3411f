"""Where a robot is beside its path, and what lies ahead on it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

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


def nearest_on_path(path: Float, x_m: float, y_m: float) -> PathPosition:
    """The nearest point of a polyline (K, 2); among equals the first. Repeated points and K = 1 are fine."""
    x, y = path[:, 0], path[:, 1]
    starts = slice(None, -1) if len(path) > 1 else slice(None)
    dx, dy = _steps(path)
    squared_length = dx * dx + dy * dy
    along = (x_m - x[starts]) * dx + (y_m - y[starts]) * dy
    fraction = np.minimum(np.maximum(along / np.where(squared_length > 0, squared_length, 1.0), 0.0), 1.0)
    near_x, near_y = x[starts] + fraction * dx, y[starts] + fraction * dy
    squared = (near_x - x_m) ** 2 + (near_y - y_m) ** 2
    best = int(squared.argmin())
    distance, at_x, at_y = math.sqrt(squared[best]), float(near_x[best]), float(near_y[best])
    heading = segment_heading(path, best)
    if math.cos(heading) * (y_m - at_y) - math.sin(heading) * (x_m - at_x) < 0:
        distance = -distance
    return PathPosition(best, float(fraction[best]), at_x, at_y, distance, heading)


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


def remaining_length(path: Float, segment: int, fraction: float) -> float:
    """Metres along the path (K, 2) from a point on it to its end."""
    length_m = np.hypot(*_steps(path))[segment:]
    length_m[:1] *= 1 - fraction
    return float(length_m.sum())


def points_at_lengths(path: Float, length_m: Float) -> Float:
    """The points (N, 2) so far along the path (K, 2) from its start, (N,); its ends beyond that."""
    arc_m = np.concatenate([[0.0], np.cumsum(np.hypot(*_steps(path)))])[: len(path)]
    return np.stack([np.interp(length_m, arc_m, path[:, axis]) for axis in (0, 1)], axis=1)


def lookahead_point(path: Float, x_m: float, y_m: float, near: PathPosition, lookahead_m: float) -> tuple[float, float]:
    """The first point of the path, from the nearest one on, that is lookahead_m away from the robot.

    The end of the path when it ends nearer than that; the nearest point itself when that is farther already.
    """
    start_x, start_y = near.x_m, near.y_m
    if math.hypot(start_x - x_m, start_y - y_m) >= lookahead_m:
        return start_x, start_y
    away_m = np.hypot(path[near.segment + 1 :, 0] - x_m, path[near.segment + 1 :, 1] - y_m)
    outside = int((away_m >= lookahead_m).argmax()) if len(away_m) else 0
    if len(away_m) == 0 or away_m[outside] < lookahead_m:
        return float(path[-1, 0]), float(path[-1, 1])
    end_x, end_y = path[near.segment + 1 + outside].tolist()
    if outside > 0:
        start_x, start_y = path[near.segment + outside].tolist()
    # |start + s d - robot| = l, from inside the circle to outside: one root in 0..1.
    dx, dy = end_x - start_x, end_y - start_y
    from_x, from_y = start_x - x_m, start_y - y_m
    a, b = dx * dx + dy * dy, from_x * dx + from_y * dy
    c = from_x * from_x + from_y * from_y - lookahead_m * lookahead_m
    s = (-b + math.sqrt(max(b * b - a * c, 0.0))) / a
    return start_x + s * dx, start_y + s * dy


def _steps(path: Float) -> tuple[Float, Float]:
    """(dx, dy), (K - 1,) each, from point to point; one of no length for a path of one point."""
    if len(path) == 1:
        return np.zeros(1), np.zeros(1)
    return path[1:, 0] - path[:-1, 0], path[1:, 1] - path[:-1, 1]
