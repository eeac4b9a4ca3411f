"""Polylines in the plane: length along the way, points at given lengths, whether a grid lets them through, and how
they are smoothed.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from quadlog.compiled import kernel
from quadlog.geometry import arc_lengths
from quadlog.messages import Float, Int
from quadlog.planning.protocol import Bool

# Fractions of a segment nearer than this are one: the segment passes through a corner.
CORNER = 1e-9


def resample(points: Float, count: int, arc: Float | None = None) -> Float:
    """(count, 2): points of a polyline (K, 2) at equal fractions of its length, its ends included. arc: its lengths."""
    arc, resampled = arc_lengths(points) if arc is None else arc, np.empty((count, 2))
    wanted = np.arange(count) * (arc[-1] / max(count - 1, 1))  # as np.linspace, in a fraction of its time
    wanted[-1] = arc[-1]
    for axis in (0, 1):
        resampled[:, axis] = np.interp(wanted, arc, points[:, axis])
    return resampled


def turning(points: Float) -> tuple[float, float]:
    """(length, sum of the changes of heading in radians, left or right alike) of a polyline (K, 2) without repeats."""
    steps = np.diff(np.asarray(points, dtype=np.float64), axis=0)
    length = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    (x, y), (next_x, next_y) = steps[:-1].T, steps[1:].T
    return length, float(np.abs(np.arctan2(x * next_y - y * next_x, x * next_x + y * next_y)).sum())


@kernel
def is_free(blocked: Bool, points_cells: Float) -> bool:
    """Whether a polyline (K, 2) touches free cells only; in cells: cell (c, r) spans [c, c+1) by [r, r+1).

    Walks from cell to cell exactly, so no thin corner slips between samples.
    Through a common corner of four cells it passes diagonally. Outside is blocked.
    """
    rows, cols = blocked.shape
    last = len(points_cells) - 1
    for i in range(last if last > 0 else 1):
        j = i + 1 if last > 0 else i
        x, y = points_cells[i, 0], points_cells[i, 1]
        dx, dy = points_cells[j, 0] - x, points_cells[j, 1] - y
        col, row = math.floor(x), math.floor(y)
        end_col, end_row = math.floor(x + dx), math.floor(y + dy)
        # How far along the segment, of 0..1, the next border of a column and of a row is met.
        across = (col + (dx > 0) - x) / dx if dx != 0 else math.inf
        along = (row + (dy > 0) - y) / dy if dy != 0 else math.inf
        while True:
            if col < 0 or row < 0 or col >= cols or row >= rows or blocked[row, col]:
                return False
            if col == end_col and row == end_row:
                break
            # Both at once where the borders meet in a corner.
            take_col = col != end_col and (row == end_row or across < along + CORNER)
            take_row = row != end_row and (col == end_col or along < across + CORNER)
            if take_col:
                col += 1 if dx > 0 else -1
                across += abs(1 / dx)
            if take_row:
                row += 1 if dy > 0 else -1
                along += abs(1 / dy)
    return True


# A curved corner has at least this many chords, whatever the spacing.
LEAST_CHORDS = 4
# Samples from which a corner's length and its equal spacing are taken.
DENSE_SAMPLES = np.linspace(0.0, 1.0, 33)
SAME_SLOPE = 1e-6


def smooth_path(
    points_m: Float, merge_m: float, spacing_m: float, blocked: Bool, origin_m: Float, cell_m: float
) -> Float:
    """The smooth curve (K, 2) along a path (L, 2), both in map [Planning, eq. 14].

    merge_m: inflection points closer than this become one.
    spacing_m: the points of the curve lie at most so far apart.
    blocked (rows, cols): the grid the path was planned on, its lower-left corner at origin_m (2,).
    """
    path = without_repeats((points_m - origin_m) / cell_m)
    spacing = spacing_m / cell_m
    corners = control_points(path, merge_m / cell_m, blocked)
    before, after = np.concatenate([corners[:1], corners[:-1]]), np.concatenate([corners[1:], corners[-1:]])
    dense = spline_point(before[:, None], corners[:, None], after[:, None], DENSE_SAMPLES)
    sides = zip(dense, (before + corners) / 2, corners, (corners + after) / 2, strict=True)
    curve = without_repeats(np.concatenate([_rounded_corner(*each, spacing, blocked) for each in sides]))
    return curve * cell_m + origin_m


def straight_path(points_m: Float, spacing_m: float) -> Float:
    """The path (L, 2) itself, its points at most spacing_m apart: what is walked when smoothing is off."""
    path = without_repeats(points_m)
    return np.concatenate([path[:1], *(_chord(a, b, spacing_m)[1:] for a, b in pairwise(path))])


def spline_point(before: Float, at: Float, after: Float, t: Float) -> Float:
    """Points (..., N, 2) of the quadratic B-spline on three control points (..., 1, 2) or (2,), t (N,) in [0, 1]
    [Planning, eq. 14].
    """
    t = t[:, None]
    return 0.5 * ((1 - t) ** 2 * before + (1 + 2 * t - 2 * t**2) * at + t**2 * after)


def inflection_indices(path: Float) -> Int:
    """Indices (M,) of the points of a path (L, 2) where its slope changes, both ends included."""
    steps = np.diff(path, axis=0)
    slopes = steps / np.hypot(steps[:, 0], steps[:, 1])[:, None]
    turns = (np.abs(np.diff(slopes, axis=0)) > SAME_SLOPE).any(axis=1)
    return np.concatenate([[0], np.flatnonzero(turns) + 1, [len(path) - 1]]).astype(np.int64)


def control_points(path: Float, merge_distance: float, blocked: Bool) -> Float:
    """The path's inflection points (M, 2) without those close to the one before; all in cells.

    The straight lines between the points returned are free: where merging would
    make one that is not, the points merged there are kept.
    """
    if len(path) < 2:
        return path
    turning = inflection_indices(path)
    kept = _merge_close(path, turning, merge_distance)
    result = [int(kept[0])]
    for first, last in pairwise(kept):
        between = turning[(turning > first) & (turning < last)]
        if len(between) and not is_free(blocked, path[[first, last]]):
            result.extend(int(i) for i in between)
        result.append(int(last))
    return path[result]


def _merge_close(path: Float, turning: Int, merge_distance: float) -> list[int]:
    last = int(turning[-1])
    kept = [int(turning[0])]
    for i in turning[1:-1]:
        if math.dist(path[i], path[kept[-1]]) >= merge_distance and math.dist(path[i], path[last]) >= merge_distance:
            kept.append(int(i))
    return [*kept, last]


def _rounded_corner(
    dense: Float, middle_before: Float, at: Float, middle_after: Float, spacing: float, blocked: Bool
) -> Float:
    """The curve from the middle of one side to the middle of the next, or those sides where it is not free."""
    arc = arc_lengths(dense)
    curve = resample(dense, max(math.ceil(arc[-1] / spacing), LEAST_CHORDS) + 1, arc)
    if is_free(blocked, curve):
        return curve
    return np.concatenate([_chord(middle_before, at, spacing), _chord(at, middle_after, spacing)[1:]])


def _chord(start: Float, end: Float, spacing: float) -> Float:
    """A straight line as points at most `spacing` apart."""
    count = max(math.ceil(math.dist(start, end) / spacing), 1)
    return np.linspace(start, end, count + 1)


def without_repeats(points: Float) -> Float:
    """A polyline (K, 2) without the points that are where the one before is."""
    moved = (points[1:] != points[:-1]).any(axis=1)
    return points[np.concatenate([[True], moved])]
