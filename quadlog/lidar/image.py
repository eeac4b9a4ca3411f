"""A scan as an image of beams by azimuth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.beams import Beams
from quadlog.lidar.points import columns_of
from quadlog.lidar.polar import Polar
from quadlog.messages import Float32


class Image(NamedTuple):
    """Cells (rows, columns) of the nearest return of each beam and step, 0 where there is none.

    range_m: (2, rows, columns), of the nearest return and of the next one in the same cell. distance_m: horizontal,
    from below the lidar; z_m: in base. cell: (N,) int32 of each point, row * columns + column, -1 for none.
    point: (rows, columns) int32, which point is in a cell, -1 for none. doubled: whether any cell holds two.
    """

    range_m: Float32
    distance_m: Float32
    z_m: Float32
    cell: NDArray[np.int32]
    point: NDArray[np.int32]
    doubled: bool


def range_image(polar: Polar, beams: Beams, x_m: float, y_m: float) -> Image:
    """Lay the points into the image; the lidar stands at (x_m, y_m) of base."""
    n, shape = len(beams.beam), (len(beams.descending), beams.columns)
    range_m, distance_m, z_m = (
        np.zeros((2, *shape), np.float32),
        np.zeros(shape, np.float32),
        np.zeros(shape, np.float32),
    )
    cell, point = np.empty(n, np.int32), np.full(shape, -1, np.int32)
    column, away_m = np.empty(n, np.int32), np.empty(n, np.float32)
    places_m = columns_of(polar.xyz_base_m)
    _steps(places_m[0], places_m[1], polar.turn, beams.columns, beams.phase, x_m, y_m, column, away_m)
    first = np.full(int(beams.beam.max(initial=0)) + 1, -1, np.int32)
    known = beams.row[: len(first)]
    first[: len(known)] = np.where(known < 0, -1, known * beams.columns)
    doubled = _lay(
        polar.range_m,
        beams.beam,
        first,
        column,
        away_m,
        places_m[2],
        range_m.reshape(2, -1),
        distance_m.reshape(-1),
        z_m.reshape(-1),
        cell,
        point.reshape(-1),
    )
    return Image(range_m, distance_m, z_m, cell, point, doubled)


@njit(cache=True, error_model="numpy")
def _steps(
    base_x_m: Float32,
    base_y_m: Float32,
    turn: Float32,
    columns: int,
    phase: float,
    x_m: float,
    y_m: float,
    column: NDArray[np.int32],
    away_m: Float32,
) -> None:
    """Column of each point and its horizontal distance, without branches, so that it becomes vector instructions."""
    steps, shift, last = np.float32(columns), np.float32(1.5 - phase), np.int32(columns)
    x0, y0 = np.float32(x_m), np.float32(y_m)
    for i in range(len(turn)):
        c = np.int32(turn[i] * steps + shift) - np.int32(1)
        c = c + last if c < 0 else c
        column[i] = c - last if c >= last else c
        dx, dy = base_x_m[i] - x0, base_y_m[i] - y0
        away_m[i] = np.sqrt(dx * dx + dy * dy)


@njit(cache=True, error_model="numpy")
def _lay(
    ranges_m: Float32,
    beam: NDArray[np.uint16],
    first: NDArray[np.int32],
    column: NDArray[np.int32],
    away_m: Float32,
    height_m: Float32,
    range_m: Float32,
    distance_m: Float32,
    z_m: Float32,
    cell: NDArray[np.int32],
    point: NDArray[np.int32],
) -> bool:
    """first: cell in which each beam's row begins, -1 for those without. Cells are counted row by row."""
    doubled = False
    nearest, next_nearest = range_m[0], range_m[1]
    for i in range(len(ranges_m)):
        r, begin = ranges_m[i], first[beam[i]]
        if r == 0 or begin < 0:
            cell[i] = -1
            continue
        k = np.uint32(begin + column[i])
        cell[i] = k
        before = nearest[k]
        if before > 0:
            doubled = True
            next_nearest[k] = max(r, before)
            if r >= before:
                continue
        nearest[k], point[k] = r, i
        distance_m[k], z_m[k] = away_m[i], height_m[i]
    return doubled
