"""Polylines in the plane: their length along the way, points at given lengths, and whether a grid lets them through."""

from __future__ import annotations

import math

import numpy as np

from quadlog.compiled import kernel
from quadlog.messages import Float
from quadlog.planning.protocol import Bool

# Fractions of a segment nearer than this are one: the segment passes through a corner.
CORNER = 1e-9


def arc_lengths(points: Float) -> Float:
    """Length along a polyline (K, 2) from its first point to each of its points, (K,)."""
    steps = points[1:] - points[:-1]
    lengths = np.zeros(len(points))
    np.cumsum(np.hypot(steps[:, 0], steps[:, 1]), out=lengths[1:])
    return lengths


def resample(points: Float, count: int) -> Float:
    """(count, 2): points of a polyline (K, 2) at equal fractions of its length, its ends included."""
    arc = arc_lengths(points)
    wanted = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(wanted, arc, points[:, axis]) for axis in (0, 1)], axis=1)


def turning(points: Float) -> tuple[float, float]:
    """(length, sum of the changes of heading in radians, left or right alike) of a polyline (K, 2) without repeats."""
    steps = np.diff(np.asarray(points, dtype=np.float64), axis=0)
    length = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    return length, float(np.abs(_turns(steps)).sum())


def largest_curvature(points: Float) -> float:
    """Of a polyline (K, 2) without repeats: the change of heading at a point by half the length of its two sides.

    On the points of a smooth curve that is its curvature; a corner has the more the closer the points lie.
    """
    steps = np.diff(points, axis=0)
    if len(steps) < 2:
        return 0.0
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    return float((np.abs(_turns(steps)) / ((lengths[1:] + lengths[:-1]) / 2)).max())


def _turns(steps: Float) -> Float:
    """(K - 1,) angles between steps (K, 2), positive to the left."""
    (x, y), (next_x, next_y) = steps[:-1].T, steps[1:].T
    return np.arctan2(x * next_y - y * next_x, x * next_x + y * next_y)


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
