"""A scan as an image of beams by azimuth, laid out in arrays that are kept from scan to scan."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.beams import ELEVATION_BINS, Beams
from quadlog.messages import Float32

BLOCK = 1024
"""Points of which the intermediate results stay in the fastest cache."""
_SCRATCH_ROWS = 5
_HALF_BINS = np.float32(ELEVATION_BINS / 2)


class Image:
    """Cells (rows * columns,) of the nearest return of each beam and step, and behind them the other returns.

    The arrays dx_m, dy_m (from below the lidar, along base's axes), z_m (in base), height_m (above the ground), label
    (of PointClass) and slot (of time) hold rows * columns cells, row by row, and then n_others returns that share a
    cell with a nearer one or belong to no row; there is room for `room` of these.
    range_m: (2, rows * columns) of the nearest return of a cell and of the next one, 0 where there is none.
    other_range_m, other_cell: (room,) of those; the cell is -1 - column for returns that belong to no row.
    """

    def __init__(self, rows: int, columns: int, room: int) -> None:
        self.rows, self.columns, self.room = rows, columns, room
        cells = rows * columns
        self.range_m = np.zeros((2, cells), np.float32)
        self.dx_m, self.dy_m, self.z_m, self.height_m = np.zeros((4, cells + room), np.float32)
        self.label, self.slot = np.zeros((2, cells + room), np.uint8)
        self.other_range_m, self.other_cell = np.zeros(room, np.float32), np.zeros(room, np.int32)
        self.n_others = self.n_valid = self.n_without_row = 0
        self._scratch, self._column = np.zeros((_SCRATCH_ROWS, BLOCK), np.float32), np.zeros((2, BLOCK), np.int32)

    @property
    def layers(self) -> int:
        """How many layers of range_m hold anything."""
        return 2 if self.n_others else 1

    def lay(
        self,
        xyz_m: tuple[Float32, Float32, Float32],
        key: NDArray[np.uint16],
        slot: NDArray[np.uint8],
        beams: Beams,
        turning: Float32,
        ranges_m: tuple[float, float],
        phase: float,
        point: NDArray[np.int32] | None = None,
    ) -> None:
        """Lay the points x, y, z (N,) of the lidar's frame into the image.

        key: (N,) beam numbers, ignored by beams told by elevation. turning: (2, 3, 4) float32 from the lidar's frame
        to base made upright, without base's x and y of the lidar, and what that changes per time slot. ranges_m: the
        least and the most that count. phase: where within a step the points lie. point: (rows * columns + room,),
        gets the number of the point in every cell and of every other return.
        """
        n = len(xyz_m[0])
        keeps = point is not None
        numbers = point if point is not None else np.zeros(1, np.int32)
        limits = np.array([ranges_m[0] ** 2, min(ranges_m[1] ** 2, 3e38), 1.5 - phase], np.float32)
        found = _lay(
            n, *xyz_m, key, slot, beams.first_cell, beams.by_elevation, self.columns, turning.reshape(-1), limits,
            self._scratch, self._column, self.range_m[0], self.range_m[1], self.dx_m, self.dy_m, self.z_m, self.slot,
            self.other_range_m, self.other_cell, numbers, keeps,
        )  # fmt: skip
        self.n_valid, self.n_others, self.n_without_row = found


@kernel
def _lay(
    n: int,
    x_m: Float32,
    y_m: Float32,
    z_m: Float32,
    key: NDArray[np.uint16],
    slot: NDArray[np.uint8],
    first_cell: NDArray[np.int32],
    by_elevation: bool,
    columns: int,
    turning: Float32,
    limits: Float32,
    scratch: Float32,
    whole: NDArray[np.int32],
    range_m: Float32,
    next_range_m: Float32,
    cell_dx_m: Float32,
    cell_dy_m: Float32,
    cell_z_m: Float32,
    cell_slot: NDArray[np.uint8],
    other_range_m: Float32,
    other_cell: NDArray[np.int32],
    point: NDArray[np.int32],
    keeps_points: bool,
) -> tuple[int, int, int]:
    """How many returns are valid, how many have no cell of their own, and how many belong to no row.

    Block by block: first without branches and in 32 bits, so that it becomes vector instructions, what can be said of
    every point; then the scattered writes.
    """
    nothing, last_key, cells = np.float32(0), len(first_cell) - 1, np.int64(len(range_m))
    range_m[:] = nothing
    r_m, column, bins = scratch[0], whole[0], whole[1]
    x_out, y_out, z_out, part = scratch[1], scratch[2], scratch[3], scratch[4]
    n_valid, n_others, n_without = 0, 0, 0
    for begin in range(0, n, BLOCK):
        size = min(BLOCK, n - begin)
        # An index the compiler cannot see to be positive would keep the loops from becoming vector instructions.
        xs, ys, zs, slots = x_m[begin:], y_m[begin:], z_m[begin:], slot[begin:]
        _directions(size, xs, ys, zs, limits, columns, r_m, part, column)
        _turned(size, xs, ys, zs, slots, turning, x_out, y_out, z_out)
        if by_elevation:
            for j in range(size):
                bins[j] = np.int32((zs[j] / max(r_m[j], np.float32(1e-3)) + np.float32(1)) * _HALF_BINS)
        else:
            for j in range(size):
                bins[j] = np.int32(key[begin + j])
        for j in range(size):
            r = r_m[j]
            if r == nothing:
                continue
            n_valid += 1
            row_begins = first_cell[np.uint32(min(bins[j], last_key))]
            cell = np.int64(row_begins) + column[j]
            if row_begins >= 0 and range_m[np.uint32(cell)] == nothing:
                k = np.uint32(cell)
                range_m[k], cell_dx_m[k], cell_dy_m[k], cell_z_m[k] = r, x_out[j], y_out[j], z_out[j]
                cell_slot[k] = slots[j]
                if keeps_points:
                    point[k] = begin + j
                continue
            other = np.uint32(cells + n_others)
            at = np.uint32(n_others)
            n_others += 1
            k = np.uint32(cell)
            if row_begins < 0 or r >= range_m[k]:
                other_range_m[at], cell_slot[other] = r, slots[j]
                cell_dx_m[other], cell_dy_m[other], cell_z_m[other] = x_out[j], y_out[j], z_out[j]
                if keeps_points:
                    point[other] = begin + j
            else:
                other_range_m[at], cell_slot[other] = range_m[k], cell_slot[k]
                cell_dx_m[other], cell_dy_m[other], cell_z_m[other] = cell_dx_m[k], cell_dy_m[k], cell_z_m[k]
                range_m[k], cell_dx_m[k], cell_dy_m[k], cell_z_m[k] = r, x_out[j], y_out[j], z_out[j]
                cell_slot[k] = slots[j]
                if keeps_points:
                    point[other], point[k] = point[k], begin + j
            other_cell[at] = cell if row_begins >= 0 else -1 - column[j]
            n_without += row_begins < 0
    if n_others > 0:
        next_range_m[:] = nothing
    for i in range(n_others):
        if other_cell[i] >= 0:
            k = np.uint32(other_cell[i])
            next_range_m[k] = max(next_range_m[k], other_range_m[i])
    return n_valid, n_others, n_without


@inner
def _directions(
    size: int,
    x_m: Float32,
    y_m: Float32,
    z_m: Float32,
    limits: Float32,
    columns: int,
    r_m: Float32,
    part: Float32,
    column: NDArray[np.int32],
) -> None:
    """Range of each point of a block, 0 where it does not count, and its column.

    The arctangent is a polynomial of degree 9 (Abramowitz and Stegun 4.4.49, error below 1e-5 rad): a hundredth of
    the step between two columns of any spinning lidar.
    """
    nothing, tiny, steps, last = np.float32(0), np.float32(1e-30), np.float32(columns), np.int32(columns)
    least, most, shift = limits[0], limits[1], limits[2]
    for j in range(size):
        x, y, z = x_m[j], y_m[j], z_m[j]
        squared = x * x + y * y + z * z
        real = (squared > nothing) & (squared >= least) & (squared <= most)
        r_m[j] = np.sqrt(squared) if real else nothing
        size_x, size_y = abs(x), abs(y)
        steep = size_y > size_x
        larger, smaller = size_y if steep else size_x, size_x if steep else size_y
        q = smaller / (larger if larger > tiny else tiny)
        s = q * q
        rad = np.float32(0.1801410) + s * (np.float32(-0.0851330) + s * np.float32(0.0208351))
        rad = q * (np.float32(0.9998660) + s * (np.float32(-0.3302995) + s * rad))
        turn = rad * np.float32(0.5 / math.pi)
        turn = np.float32(0.25) - turn if steep else turn
        turn = np.float32(0.5) - turn if x < nothing else turn
        turn = np.float32(1.0) - turn if y < nothing else turn
        part[j] = turn if real else nothing
    for j in range(size):
        c = np.int32(part[j] * steps + shift) - np.int32(1)
        c = c + last if c < 0 else c
        column[j] = c - last if c >= last else c


@inner
def _turned(
    size: int,
    x_m: Float32,
    y_m: Float32,
    z_m: Float32,
    slot: NDArray[np.uint8],
    t: Float32,
    x_out: Float32,
    y_out: Float32,
    z_out: Float32,
) -> None:
    """Points of a block in base made upright, by the tilt of their time slots."""
    for j in range(size):
        x, y, z, s = x_m[j], y_m[j], z_m[j], np.float32(slot[j])
        x_out[j] = (t[0] + s * t[12]) * x + (t[1] + s * t[13]) * y + (t[2] + s * t[14]) * z
        y_out[j] = (t[4] + s * t[16]) * x + (t[5] + s * t[17]) * y + (t[6] + s * t[18]) * z
        z_out[j] = (t[8] + s * t[20]) * x + (t[9] + s * t[21]) * y + (t[10] + s * t[22]) * z + t[11]
