"""Where a scan's rays went: what was seen through is free, as far down as it was seen through."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.window import Window
from quadlog.messages import Float

LINES = 512
"""Directions followed; at the edge of a 20 m window they are about as far apart as a cell of 0.1 m is wide."""
RAYS_IN_SECTOR = 16
"""A scan with few columns gets wider sectors, so that none is empty between two of them: one column of 16 beams."""
STEEPEST, FLATTEST, BINS = -1.0, 0.25, 40
"""Rays are told apart by how far they climb per metre; 40 bins are 1.8 degrees each, finer than beams are apart."""


def lowest_rays(
    origin_base_m: Float, end_base_m: Float, end_height_m: Float, pose_base_in_map: Float, window: Window
) -> NDArray[np.float32]:
    """How high above the ground the lowest ray crossed each cell: (rows, cols) in metres, inf where none did.

    The rays run straight from origin_base_m (3,), x and y in base and height
    above the ground, to where they ended, end_base_m (N, 3) in base, of which
    x and y count, and end_height_m (N,); NaN for rays that count for nothing.
    pose_base_in_map: (3,) x, y in metres and yaw in radians.
    Rays of one sector and one slope count as one, the shortest and flattest
    of them, so that a cell is called crossed only where all agree. The cell
    in which a ray ends is not crossed by it.
    """
    lowest_m = np.full(window.shape, np.inf, dtype=np.float32)
    x_m, y_m, height_m = (float(each) for each in origin_base_m)
    sectors = 2 ** int(np.log2(np.clip(len(end_base_m) // RAYS_IN_SECTOR, 64, LINES)))
    reach_m, slope = _by_sector(x_m, y_m, height_m, end_base_m, end_height_m, sectors)
    cos, sin = math.cos(pose_base_in_map[2]), math.sin(pose_base_in_map[2])
    start_m = pose_base_in_map[0] + cos * x_m - sin * y_m, pose_base_in_map[1] + sin * x_m + cos * y_m
    col, row = start_m[0] / window.cell_m - window.col0, start_m[1] / window.cell_m - window.row0
    _walk(reach_m / window.cell_m, slope * window.cell_m, float(col), float(row), (cos, sin), height_m, lowest_m)
    return lowest_m


@njit(cache=True)
def _by_sector(
    x_m: float, y_m: float, height_m: float, end_m: Float, end_height_m: Float, sectors: int
) -> tuple[Float, Float]:
    """Horizontal length and slope (sectors, BINS) of the ray that stands for each bin; length zero where none does."""
    reach_m, slope = np.zeros((sectors, BINS)), np.zeros((sectors, BINS))
    per_bin = BINS / (FLATTEST - STEEPEST)
    for i in range(len(end_m)):
        dx, dy = end_m[i, 0] - x_m, end_m[i, 1] - y_m
        size = abs(dx) + abs(dy)
        # NaN and infinity fail this comparison as well.
        if not 1e-3 < size < 1e6:
            continue
        # The diamond's angle: it grows with the true one, and costs no arctangent.
        turn = dy / size + 1.0 if dx >= 0.0 else 3.0 - dy / size
        sector = min(int(turn * (sectors / 4)), sectors - 1)
        length_m = np.sqrt(dx * dx + dy * dy)
        rise = (end_height_m[i] - height_m) / length_m
        if not rise < FLATTEST:
            continue
        k = max(int((rise - STEEPEST) * per_bin), 0)
        if reach_m[sector, k] == 0.0 or length_m < reach_m[sector, k]:
            reach_m[sector, k] = length_m
        if slope[sector, k] == 0.0 or rise > slope[sector, k]:
            slope[sector, k] = rise
    return reach_m, slope


@njit(cache=True)
def _walk(
    reach: Float,
    rise: Float,
    start_col: float,
    start_row: float,
    turn_base_to_map: tuple[float, float],
    height_m: float,
    lowest_m: NDArray[np.float32],
) -> None:
    """Go through the cells along every line; lengths are in cells, rise in metres per cell, the turn (cos, sin)."""
    cos, sin = turn_base_to_map
    rows, cols = lowest_m.shape
    for line in range(LINES):
        sector = line * len(reach) // LINES
        turn = (line + 0.5) * (4.0 / LINES) - 1.0
        dy = turn if turn <= 1.0 else 2.0 - turn
        dx = 1.0 - abs(dy) if turn <= 1.0 else abs(dy) - 1.0
        size = np.sqrt(dx * dx + dy * dy)
        dx, dy = (cos * dx - sin * dy) / size, (sin * dx + cos * dy) / size
        # Along the longer axis cell by cell: every step enters the next column or row.
        step = 1.0 / max(abs(dx), abs(dy))
        along, k = 0.5 * step, 0
        while True:
            # A ray that ended stays ended, and flatter ones pass higher: the bin only ever goes up.
            while k < BINS and reach[sector, k] <= along + 1.0:
                k += 1
            if k == BINS:
                break
            # Compared as floats: a start far outside the window must not reach the cast to an index.
            col, row = np.floor(start_col + along * dx), np.floor(start_row + along * dy)
            if not (col >= 0 and col < cols and row >= 0 and row < rows):
                break
            passed_m = height_m + rise[sector, k] * along
            if passed_m < lowest_m[int(row), int(col)]:
                lowest_m[int(row), int(col)] = passed_m
            along += step
