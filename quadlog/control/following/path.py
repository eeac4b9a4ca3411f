"""Where a robot is beside its path, what lies ahead on it, and how far ahead of it the straight way there is free."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadlog.compiled import kernel
from quadlog.messages import Float
from quadlog.planning.path import is_free
from quadlog.planning.protocol import Bool

LEAST_CHORD_M = 0.3
"""However narrow it is, the look-ahead point lies at least so far from the robot, or is the path's end: a shorter chord
turns with every centimetre that the robot is beside its path."""


class FreeSpace(NamedTuple):
    """Cells (rows, cols) that a robot's middle should keep out of; the lower-left corner of (0, 0) is at origin_m (2,).

    What lies outside of them counts as blocked.
    """

    blocked: Bool
    origin_m: tuple[float, float]
    cell_m: float


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
    return nearest_between(path, (0, 0.0), (max(len(path) - 2, 0), 1.0), x_m, y_m)


def nearest_between(
    path: Float, low: tuple[int, float], high: tuple[int, float], x_m: float, y_m: float
) -> PathPosition:
    """The same on the part of it from one (segment, fraction) to another, not before it."""
    return PathPosition(*_nearest(path, low[0], low[1], high[0], high[1], x_m, y_m))


def lookahead(
    path: Float,
    x_m: float,
    y_m: float,
    near: PathPosition,
    lookahead_m: float,
    reach_m: float,
    space: FreeSpace | None = None,
) -> tuple[float, float, float]:
    """(x_m, y_m, along_m) of the first point of the path, from the nearest on, that is lookahead_m away from the robot.

    At most reach_m along the path, and along_m is how far; the end of the path when it ends nearer than that; the
    nearest point itself when that is farther already. With a space no farther along the path than the straight line to
    every point before it runs in it: a robot that aims at a point behind an obstacle's corner cuts it, though its path
    goes round. The point is at least LEAST_CHORD_M away all the same.
    """
    aim = path, near.segment, near.x_m, near.y_m, x_m, y_m, lookahead_m, reach_m
    if space is None:
        return _ahead(*aim)
    return _ahead_in_free_space(*aim, space.blocked, *space.origin_m, space.cell_m, LEAST_CHORD_M)


@kernel
def _nearest(
    path: Float, first: int, low: float, last: int, high: float, x: float, y: float
) -> tuple[int, float, float, float, float, float]:
    """A PathPosition: the nearest point between (first, low) and (last, high).

    Its heading is that of its segment, or of the nearest one that has a length.
    """
    best, best_fraction, best_x, best_y, best_squared = first, 0.0, path[first, 0], path[first, 1], math.inf
    for i in range(first, last + 1):
        start_x, start_y = path[i, 0], path[i, 1]
        dx, dy = 0.0, 0.0
        if i + 1 < len(path):
            dx, dy = path[i + 1, 0] - start_x, path[i + 1, 1] - start_y
        squared_length = dx * dx + dy * dy
        along = (x - start_x) * dx + (y - start_y) * dy
        fraction = min(max(along / squared_length, 0.0), 1.0) if squared_length > 0 else 0.0
        if i == first:
            fraction = max(fraction, low)
        if i == last:
            fraction = min(fraction, high)
        near_x, near_y = start_x + fraction * dx, start_y + fraction * dy
        squared = (near_x - x) ** 2 + (near_y - y) ** 2
        if squared < best_squared:
            best, best_fraction, best_x, best_y, best_squared = i, fraction, near_x, near_y, squared
    heading, distance = math.nan, math.hypot(best_x - x, best_y - y)
    for apart in range(2 * len(path)):
        i = best + apart // 2 * (1 - 2 * (apart % 2))
        if 0 <= i < len(path) - 1 and (path[i, 0] != path[i + 1, 0] or path[i, 1] != path[i + 1, 1]):
            heading = math.atan2(path[i + 1, 1] - path[i, 1], path[i + 1, 0] - path[i, 0])
            break
    if math.cos(heading) * (y - best_y) - math.sin(heading) * (x - best_x) < 0:
        distance = -distance
    return best, best_fraction, best_x, best_y, distance, heading


@kernel
def _ahead(
    path: Float, segment: int, near_x: float, near_y: float, x: float, y: float, lookahead: float, reach: float
) -> tuple[float, float, float]:
    """(x, y, length along the path) of the first point that is lookahead away, or reach along, or the end."""
    start_x, start_y, along = near_x, near_y, 0.0
    if math.hypot(start_x - x, start_y - y) >= lookahead:
        return start_x, start_y, along
    for i in range(segment + 1, len(path)):
        dx, dy = path[i, 0] - start_x, path[i, 1] - start_y
        length = math.hypot(dx, dy)
        s = 1.0
        outside = math.hypot(path[i, 0] - x, path[i, 1] - y) >= lookahead
        if outside:
            # |start + s d - robot| = l, from inside the circle to outside: one root in 0..1.
            from_x, from_y = start_x - x, start_y - y
            a, b = dx * dx + dy * dy, from_x * dx + from_y * dy
            c = from_x * from_x + from_y * from_y - lookahead * lookahead
            s = (-b + math.sqrt(max(b * b - a * c, 0.0))) / a
        if along + s * length > reach:
            outside, s = True, (reach - along) / length
        if outside:
            return start_x + s * dx, start_y + s * dy, along + s * length
        start_x, start_y, along = path[i, 0], path[i, 1], along + length
    return start_x, start_y, along


@kernel
def _ahead_in_free_space(  # type: ignore[no-untyped-def]
    path, segment, near_x, near_y, x, y, lookahead, reach, blocked, origin_x, origin_y, cell, least
):
    """_ahead, but no farther than where, in steps of half a cell along the path, the straight line there is blocked."""
    end_x, end_y, end_along = _ahead(path, segment, near_x, near_y, x, y, lookahead, reach)
    chord = np.empty((2, 2))
    chord[0, 0], chord[0, 1] = (x - origin_x) / cell, (y - origin_y) / cell
    at_x, at_y, at_along = near_x, near_y, 0.0
    from_x, from_y, along, i, left = near_x, near_y, 0.0, segment + 1, 0.5 * cell
    while along < end_along:
        length = math.hypot(path[i, 0] - from_x, path[i, 1] - from_y) if i < len(path) else math.inf
        if length < left:
            from_x, from_y, along, left, i = path[i, 0], path[i, 1], along + length, left - length, i + 1
            continue
        along += left
        if along >= end_along or i >= len(path):
            next_x, next_y, along = end_x, end_y, end_along
        else:
            share = left / length
            next_x, next_y = from_x + share * (path[i, 0] - from_x), from_y + share * (path[i, 1] - from_y)
        chord[1, 0], chord[1, 1] = (next_x - origin_x) / cell, (next_y - origin_y) / cell
        if math.hypot(next_x - x, next_y - y) > least and not is_free(blocked, chord):
            return at_x, at_y, at_along
        from_x, from_y, left = next_x, next_y, 0.5 * cell
        at_x, at_y, at_along = next_x, next_y, along
    return end_x, end_y, end_along
