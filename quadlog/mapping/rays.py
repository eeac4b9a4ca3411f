"""Where a scan's rays went: what was seen through is free, as far down as it was seen through."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.points import columns_of
from quadlog.mapping.window import Window
from quadlog.messages import Float, Float32

LINES = 512
"""Directions followed; at the edge of a 20 m window they are about as far apart as a cell of 0.1 m is wide."""
RAYS_IN_SECTOR = 16
"""A scan with few columns gets wider sectors, so that none is empty between two of them: one column of 16 beams."""
STEEPEST, FLATTEST, BINS = -1.0, 0.25, 40
"""Rays are told apart by how far they climb per metre; 40 bins are 1.8 degrees each, finer than beams are apart."""


def lowest_rays(
    origin_base_m: Float, end_base_m: Float32, end_height_m: Float32, pose_base_in_map: Float, window: Window
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
    n = len(end_base_m)
    # What a driver sends for rays without a return says nothing about how dense the others are.
    n_ended = np.count_nonzero(~np.isnan(end_height_m))
    sectors = 2 ** int(np.log2(np.clip(n_ended // RAYS_IN_SECTOR, 64, LINES)))
    # The last one is for rays that count for nothing.
    reach_m, slope = np.full(sectors * BINS + 1, np.inf, np.float32), np.full(sectors * BINS + 1, -np.inf, np.float32)
    place, length_m, rise = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.float32)
    end_x_m, end_y_m, _ = columns_of(end_base_m)
    _length(end_x_m, end_y_m, x_m, y_m, length_m)
    _climb(end_height_m, length_m, height_m, rise)
    _choose_bins(end_x_m, end_y_m, x_m, y_m, rise, sectors, place)
    _gather(place, length_m, rise, reach_m, slope)
    cos, sin = math.cos(pose_base_in_map[2]), math.sin(pose_base_in_map[2])
    start_m = pose_base_in_map[0] + cos * x_m - sin * y_m, pose_base_in_map[1] + sin * x_m + cos * y_m
    col, row = start_m[0] / window.cell_m - window.col0, start_m[1] / window.cell_m - window.row0
    if 0 <= col < window.shape[1] and 0 <= row < window.shape[0]:
        _walk(reach_m, slope, window.cell_m, float(col), float(row), cos, sin, height_m, lowest_m)
    return lowest_m


# The first three have no branches, and few arrays each, so that they become vector instructions.
@njit(cache=True, error_model="numpy")
def _length(end_x_m: Float32, end_y_m: Float32, x_m: float, y_m: float, length_m: Float32) -> None:
    x0, y0 = np.float32(x_m), np.float32(y_m)
    for i in range(len(length_m)):
        dx, dy = end_x_m[i] - x0, end_y_m[i] - y0
        length_m[i] = np.sqrt(dx * dx + dy * dy)


@njit(cache=True, error_model="numpy")
def _climb(end_height_m: Float32, length_m: Float32, height_m: float, rise: Float32) -> None:
    z0 = np.float32(height_m)
    for i in range(len(rise)):
        rise[i] = (end_height_m[i] - z0) / length_m[i]


@njit(cache=True, error_model="numpy")
def _choose_bins(
    end_x_m: Float32, end_y_m: Float32, x_m: float, y_m: float, rise: Float32, sectors: int, place: NDArray[np.int32]
) -> None:
    """Sector * BINS + bin of each ray, one more than there are for those that count for nothing."""
    x0, y0, nothing, one = np.float32(x_m), np.float32(y_m), np.float32(0), np.float32(1)
    per_turn, per_bin = np.float32(sectors / 4), np.float32(BINS / (FLATTEST - STEEPEST))
    last, steepest, flattest = np.float32(sectors - 1), np.float32(STEEPEST), np.float32(FLATTEST)
    nowhere = np.int32(sectors * BINS)
    for i in range(len(place)):
        dx, dy = end_x_m[i] - x0, end_y_m[i] - y0
        size = abs(dx) + abs(dy)
        # The diamond's angle: it grows with the true one, and costs no arctangent.
        part = dy / size
        sector = (part + one if dx >= nothing else np.float32(3) - part) * per_turn
        sector = sector if sector < last else last
        k = (rise[i] - steepest) * per_bin
        k = k if k > nothing else nothing
        # NaN and infinity fail these comparisons as well.
        counts = (size > np.float32(1e-3)) & (size < np.float32(1e6)) & (rise[i] < flattest)
        place[i] = np.int32(sector) * np.int32(BINS) + np.int32(k) if counts else nowhere


@njit(cache=True, error_model="numpy")
def _gather(place: NDArray[np.int32], length_m: Float32, rise: Float32, reach_m: Float32, slope: Float32) -> None:
    """Horizontal length and slope of the ray that stands for each bin; length infinite where none does."""
    for i in range(len(place)):
        k = np.uint32(place[i])
        # Written whatever they are: a branch that is often guessed wrongly takes longer.
        reach_m[k] = length_m[i] if length_m[i] < reach_m[k] else reach_m[k]
        slope[k] = rise[i] if rise[i] > slope[k] else slope[k]


@njit(cache=True, error_model="numpy")
def _walk(
    reach_m: Float32,
    slope: Float32,
    cell_m: float,
    start_col: float,
    start_row: float,
    cos: float,
    sin: float,
    height_m: float,
    lowest_m: Float32,
) -> None:
    """Go through the cells along every line from a start in them; cos, sin: of the turn from base to map.

    reach_m, slope: as `_gather` leaves them. Ways along a line are counted in cells.
    """
    rows, cols = lowest_m.shape
    sectors, cells_per_m = len(reach_m) // BINS, 1.0 / cell_m
    for line in range(LINES):
        first = line * sectors // LINES * BINS
        turn = (line + 0.5) * (4.0 / LINES) - 1.0
        dy = turn if turn <= 1.0 else 2.0 - turn
        dx = 1.0 - abs(dy) if turn <= 1.0 else abs(dy) - 1.0
        size = np.sqrt(dx * dx + dy * dy)
        dx, dy = (cos * dx - sin * dy) / size, (sin * dx + cos * dy) / size
        # How far it is to where the line leaves the window.
        way_col = (cols - start_col) / dx if dx > 0.0 else (start_col / -dx if dx < 0.0 else np.inf)
        way_row = (rows - start_row) / dy if dy > 0.0 else (start_row / -dy if dy < 0.0 else np.inf)
        most = min(way_col, way_row)
        # Along the longer axis cell by cell: every step enters the next column or row.
        step = 1.0 / max(abs(dx), abs(dy))
        along, k = 0.5 * step, 0
        while along < most and k < BINS:
            # A ray that ended stays ended, and flatter ones pass higher: the bin only ever goes up.
            until = reach_m[first + k] * cells_per_m - 1.0
            if until == np.inf or until <= along:
                k += 1
                continue
            until, climb = min(most, until), slope[first + k] * cell_m
            while along < until:
                # Rounding may put the last step on the window's edge.
                col, row = min(int(start_col + along * dx), cols - 1), min(int(start_row + along * dy), rows - 1)
                passed_m = np.float32(height_m + climb * along)
                if passed_m < lowest_m[row, col]:
                    lowest_m[row, col] = passed_m
                along += step
