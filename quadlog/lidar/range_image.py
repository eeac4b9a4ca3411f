"""A scan as a range image: points by direction and range, and the beams of a sensor that no message describes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.messages import Float, Float32, Int

XyzM = tuple[Float32, Float32, Float32]


class Polar(NamedTuple):
    """range_m: (N,) from the lidar, 0 for no return. sine: (N,) of the elevation; turn: (N,) azimuth, [0, 1)."""

    range_m: Float32
    sine: Float32
    turn: Float32


def to_polar(xyz_m: XyzM, ranges_m: tuple[float, float]) -> Polar:
    """Points x, y, z (N,) by direction; only ranges from the least to the most of ranges_m are returns."""
    x_m, y_m, z_m = xyz_m
    with np.errstate(all="ignore"):
        squared = x_m * x_m + y_m * y_m + z_m * z_m
        real = (squared > 0) & (squared >= np.float32(ranges_m[0] ** 2)) & (squared <= np.float32(ranges_m[1] ** 2))
        range_m = np.where(real, np.sqrt(squared), np.float32(0))
        sine = np.where(real, z_m / range_m, np.float32(0))
        turn = np.where(real, np.arctan2(y_m, x_m) * np.float32(0.5 / np.pi), np.float32(0))
    turn = np.where(turn < 0, turn + np.float32(1), turn)
    return Polar(range_m, sine, np.where(turn < 1, turn, np.float32(0)))


MOST_BEAMS = 256
FEWEST_COLUMNS, MOST_COLUMNS = 36, 3600
"""No spinning lidar steps finer than 0.1 degrees; more points than that per beam are several turns or returns."""
NO_BEAM = 65535
# A beam that scatters by more of the gap to its neighbours is no beam.
_LARGEST_SCATTER = 0.35
# What a scan in a single plane may scatter.
_FLAT_SCATTER = 0.01
_ARCS = 256
_POINTS_FOR_PHASE = 250
# A point farther from its beam's elevation than this part of the gap between two beams lies on another one.
_STRANGE = 0.75
ELEVATION_BINS = 2000
"""Of the sine of the elevation from -1 to 1: 0.06 degrees at the horizon."""
_BIN_RAD = np.deg2rad(1.5)
_FEWEST_IN_BEAM, _LEAST_SHARE_IN_BEAMS = 20, 0.95


class Beams(NamedTuple):
    """How one lidar's points go into an image; it holds as long as the sensor and its driver stay what they are.

    first_cell: (keys + 1,) int32, the cell in which the row of each beam number begins, -1 for those without one; the
    last entry stands for all numbers beyond. by_elevation: the number of a beam is the bin of its elevation's sine,
    not what the driver says. descending: (rows,) from the lowest in base up, whether the beam points below the lidar's
    own horizon. columns: steps of a full turn. sine: (keys + 1,) float32 of each beam's elevation, NaN where there is
    no beam; tolerance: how far from it a point of the beam may lie.
    """

    first_cell: NDArray[np.int32]
    by_elevation: bool
    descending: NDArray[np.bool_]
    columns: int
    sine: Float32
    tolerance: float


def beams_by_number(polar: Polar, beam: NDArray[np.uint16], upright: bool) -> Beams | None:
    """Beams by their numbers (N,), in any order; None where these do not match the elevations."""
    known = (polar.range_m > 0) & (beam < MOST_BEAMS)
    number, sine = beam[known].astype(np.int64), polar.sine[known].astype(np.float64)
    points = np.bincount(number)
    used = np.flatnonzero(points)
    if len(used) == 0:
        return None
    first = np.zeros(len(points))
    # Of repeated indices the last assignment holds: in reverse order the first point.
    first[number[::-1]] = sine[::-1]
    # About the first, so that the squares of a beam's tiny scatter are not lost in rounding.
    apart = sine - first[number]
    n, total, squares = points[used], np.bincount(number, apart)[used], np.bincount(number, apart**2)[used]
    mean = first[used] + total / n
    scatter = np.sqrt(max(np.sum(squares - total**2 / n), 0.0) / n.sum())
    order = np.argsort(mean if upright else -mean, kind="stable")
    gaps = np.sort(np.abs(np.diff(mean[order])))
    gap = gaps[len(gaps) // 2] if len(gaps) else _FLAT_SCATTER / _LARGEST_SCATTER
    if scatter > _LARGEST_SCATTER * gap:
        return None
    descending = mean[order] < 0 if upright else mean[order] > 0
    columns = _columns(number, polar.turn[known])
    first_cell = np.full(MOST_BEAMS + 1, -1, dtype=np.int32)
    first_cell[used[order]] = np.arange(len(used)) * columns
    mean_sine = np.full(MOST_BEAMS + 1, np.nan, dtype=np.float32)
    mean_sine[used] = mean
    return Beams(first_cell, False, descending, columns, mean_sine, max(gap * _STRANGE, _FLAT_SCATTER))


def beams_by_elevation(polar: Polar, upright: bool) -> Beams | None:
    """Beams as the histogram of elevations shows them, with empty bins between; None where it shows none."""
    known = polar.range_m > 0
    bins = np.minimum(((polar.sine + 1) * (ELEVATION_BINS / 2)).astype(np.int64), ELEVATION_BINS - 1)
    count = np.bincount(bins[known], minlength=ELEVATION_BINS)
    filled = np.concatenate([[False], count > 0, [False]])
    edge = np.flatnonzero(filled[1:] != filled[:-1])
    first, last = edge[::2], edge[1::2]
    total = np.add.reduceat(np.append(count, 0), first) if len(first) else np.zeros(0)
    real = total >= _FEWEST_IN_BEAM
    if not 2 <= np.count_nonzero(real) <= MOST_BEAMS or total[real].sum() < _LEAST_SHARE_IN_BEAMS * total.sum():
        return None
    number = np.full(ELEVATION_BINS + 1, NO_BEAM, dtype=np.uint16)
    for beam, (low, high) in enumerate(zip(first[real], last[real], strict=True)):
        number[low:high] = beam
    beams = beams_by_number(polar, number[bins], upright)
    if beams is None:
        return None
    number = np.minimum(number, len(beams.first_cell) - 1)
    return beams._replace(by_elevation=True, first_cell=beams.first_cell[number], sine=beams.sine[number])


def beams_by_bins(range_m: Float32, sine: Float32) -> tuple[Beams, NDArray[np.uint16]]:
    """Bins of elevation in place of beams, and the bin (N,) of each point: about a point to a cell.

    For clouds without beams; range_m, sine: (N,) by directions along base's axes from where the lidar stands.
    """
    known = range_m > 0
    number = ((np.arcsin(np.clip(sine, -1, 1)) + np.pi / 2) / _BIN_RAD).astype(np.uint16)
    used = np.unique(number[known])
    per_turn = np.count_nonzero(known) / max(len(used), 1)
    columns = int(np.clip(per_turn, 5 * FEWEST_COLUMNS, MOST_COLUMNS / 4))
    first_cell = np.full(int(np.pi / _BIN_RAD) + 2, -1, dtype=np.int32)
    first_cell[used] = np.arange(len(used)) * columns
    below = (used + 0.5) * _BIN_RAD < np.pi / 2
    return Beams(first_cell, False, below, columns, np.zeros(len(first_cell), np.float32), np.inf), number


def phase_and_strangers(
    xyz_m: XyzM, key: NDArray[np.uint16], beams: Beams, ranges_m: tuple[float, float]
) -> tuple[float, float]:
    """Where in a step the points lie, from some of them, and the share of these that do not lie on their beams.

    The phase is in [-0.5, 0.5]. Steps that lie on the edge between two columns would be rounded into either, two
    points into one cell and none into the next. It is 0 where the points lie anywhere in a step.
    """
    # An odd step meets every beam of a sweep that is sent column by column.
    step = max(len(xyz_m[0]) // _POINTS_FOR_PHASE, 1) | 1
    x_m, y_m, z_m = (axis_m[::step].astype(np.float64) for axis_m in xyz_m)
    squared = x_m * x_m + y_m * y_m + z_m * z_m
    real = (squared >= max(ranges_m[0], 1e-9) ** 2) & (squared <= min(ranges_m[1], 1e18) ** 2)
    n = np.count_nonzero(real)
    if n == 0:
        return 0.0, 0.0
    turn_rad, sine = np.arctan2(y_m[real], x_m[real]) * beams.columns, z_m[real] / np.sqrt(squared[real])
    number = (sine + 1) * (ELEVATION_BINS / 2) if beams.by_elevation else key[::step][real]
    number = np.minimum(number.astype(np.int64), len(beams.first_cell) - 1)
    strange = beams.first_cell[number] < 0
    if not beams.by_elevation:
        strange |= ~(np.abs(sine - beams.sine[number]) <= beams.tolerance)
    cos, sin = float(np.cos(turn_rad).sum()), float(np.sin(turn_rad).sum())
    phase = math.atan2(sin, cos) / (2 * math.pi) if math.hypot(cos, sin) > 0.5 * n else 0.0
    return phase, np.count_nonzero(strange) / n


def _columns(number: Int, turn: Float32) -> int:
    """Steps of a full turn of points by beam number and turn (N,), by the beam that fills the arcs it reaches best."""
    arcs = np.bincount(number * _ARCS + (turn * _ARCS).astype(np.int64), minlength=(int(number.max()) + 1) * _ARCS)
    arcs = arcs.reshape(-1, _ARCS)
    held, reached = arcs.sum(axis=1), np.count_nonzero(arcs, axis=1)
    # A beam that reaches few arcs may see some of them twice, as through leaves.
    wide = 2 * reached >= reached.max()
    per_arc = float((held[wide] / reached[wide]).max())
    if per_arc == 1:  # steps may be wider than an arc
        filled = np.flatnonzero(arcs[np.argmax(held)])
        step = np.diff(filled, append=filled[0] + _ARCS)
        per_arc = 1 / step[step <= 1.5 * np.median(step)].mean()
    return min(max(round(per_arc * _ARCS), FEWEST_COLUMNS), MOST_COLUMNS)


BLOCK = 1024
"""Points per block: its intermediate results fit the L1 cache."""
_HALF_BINS = np.float32(ELEVATION_BINS / 2)


class Returns(NamedTuple):
    """Returns of a scan along the axes of base made upright, (M,) each.

    dx_m, dy_m: from below the lidar; z_m: in base; height_m: above the ground; label: of PointClass; slot: of time;
    point: number in the message.
    """

    dx_m: Float32
    dy_m: Float32
    z_m: Float32
    height_m: Float32
    label: NDArray[np.uint8]
    slot: NDArray[np.uint8]
    point: NDArray[np.int32]


class Image(NamedTuple):
    """Cells of the nearest return of each beam and step, and behind them the other returns.

    held: rows * columns cells, row by row, and then n_others returns that share a cell with a nearer one or belong to
    no row; there is room for more. range_m: (2, rows * columns) of the nearest return of a cell and of the next one, 0
    where there is none. other_range_m, other_cell: (room,) of the others; -1 - column for those that belong to no row.
    """

    rows: int
    columns: int
    n_others: int
    range_m: Float32
    held: Returns
    other_range_m: Float32
    other_cell: NDArray[np.int32]

    @classmethod
    def empty(cls, beams: Beams, room: int) -> Image:
        """For scans of up to `room` points; work arrays that are laid again and again."""
        rows, columns = len(beams.descending), beams.columns
        cells = rows * columns
        places, (label, slot) = np.zeros((4, cells + room), np.float32), np.zeros((2, cells + room), np.uint8)
        held = Returns._make([*places, label, slot, np.zeros(cells + room, np.int32)])
        others = np.zeros(room, np.float32), np.zeros(room, np.int32)
        return cls(rows, columns, 0, np.zeros((2, cells), np.float32), held, *others)

    @property
    def filled(self) -> Returns:
        """The cells and the other returns, as views."""
        return Returns._make(each[: self.rows * self.columns + self.n_others] for each in self.held)


def lay(
    image: Image,
    xyz_m: XyzM,
    key: NDArray[np.uint16],
    slot: NDArray[np.uint8],
    beams: Beams,
    transforms: Float,
    ranges_m: tuple[float, float],
    phase: float,
) -> Image:
    """The image with points x, y, z (N,) of the lidar's frame, in the arrays of the one given.

    key: (N,) beam numbers, ignored by beams that are found by elevation. transforms: (2, 4, 4) from the lidar's
    frame to base made upright, of which base's x and y of the lidar are left out, and their change per time slot.
    ranges_m: the least and the most that count. phase: where within a step the points lie.
    """
    limits = np.array([ranges_m[0] ** 2, min(ranges_m[1] ** 2, 3e38), 1.5 - phase], np.float32)
    turning = transforms[:, :3].astype(np.float32).reshape(-1)
    how = beams.first_cell, beams.by_elevation, turning, limits
    return image._replace(n_others=_lay(*xyz_m, key, slot, *how, image))


@kernel
def _lay(
    x_m: Float32, y_m: Float32, z_m: Float32, key: NDArray[np.uint16], slot: NDArray[np.uint8],
    first_cell: NDArray[np.int32], by_elevation: bool, turning: Float32, limits: Float32, image: Image,
) -> int:  # fmt: skip
    """How many returns have no cell of their own.

    Block by block: first without branches and in 32 bits, so that it becomes vector instructions, what can be said of
    every point; then the scattered writes.
    """
    range_m, next_range_m = image.range_m[0], image.range_m[1]
    cell_dx_m, cell_dy_m, cell_z_m = image.held.dx_m, image.held.dy_m, image.held.z_m
    cell_slot, point = image.held.slot, image.held.point
    other_range_m, other_cell = image.other_range_m, image.other_cell
    nothing, last_key, cells, columns = np.float32(0), len(first_cell) - 1, np.int64(len(range_m)), image.columns
    range_m[:] = nothing
    scratch, whole = np.empty((5, BLOCK), np.float32), np.empty((2, BLOCK), np.int32)
    r_m, column, bins = scratch[0], whole[0], whole[1]
    x_out, y_out, z_out, part = scratch[1], scratch[2], scratch[3], scratch[4]
    n_others = 0
    for begin in range(0, len(slot), BLOCK):
        size = min(BLOCK, len(slot) - begin)
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
            row_begins = first_cell[np.uint32(min(bins[j], last_key))]
            cell = np.int64(row_begins) + column[j]
            at = k = np.uint32(cell)
            if row_begins < 0 or range_m[k] != nothing:
                at, other = np.uint32(cells + n_others), np.uint32(n_others)
                other_range_m[other], other_cell[other] = r, cell if row_begins >= 0 else -1 - column[j]
                n_others += 1
                if row_begins >= 0 and r < range_m[k]:
                    # The nearer return takes the cell.
                    other_range_m[other], cell_slot[at] = range_m[k], cell_slot[k]
                    cell_dx_m[at], cell_dy_m[at], cell_z_m[at] = cell_dx_m[k], cell_dy_m[k], cell_z_m[k]
                    point[at] = point[k]
                    at = k
            if at < cells:
                range_m[at] = r
            cell_dx_m[at], cell_dy_m[at], cell_z_m[at], cell_slot[at] = x_out[j], y_out[j], z_out[j], slots[j]
            point[at] = begin + j
    if n_others > 0:
        next_range_m[:] = nothing
    for i in range(n_others):
        if other_cell[i] >= 0:
            k = np.uint32(other_cell[i])
            next_range_m[k] = max(next_range_m[k], other_range_m[i])
    return n_others


@inner
def turn_of(x: np.float32, y: np.float32) -> np.float32:
    """The azimuth of (x, y) in turns, [0, 1].

    The arctangent is a polynomial of degree 9 (Abramowitz and Stegun 4.4.49, error below 1e-5 rad): a hundredth of
    the step between two columns of any spinning lidar.
    """
    size_x, size_y, tiny = abs(x), abs(y), np.float32(1e-30)
    steep = size_y > size_x
    larger, smaller = size_y if steep else size_x, size_x if steep else size_y
    q = smaller / (larger if larger > tiny else tiny)
    s = q * q
    rad = np.float32(0.1801410) + s * (np.float32(-0.0851330) + s * np.float32(0.0208351))
    rad = q * (np.float32(0.9998660) + s * (np.float32(-0.3302995) + s * rad))
    turn = rad * np.float32(0.5 / math.pi)
    turn = np.float32(0.25) - turn if steep else turn
    turn = np.float32(0.5) - turn if x < np.float32(0) else turn
    return np.float32(1.0) - turn if y < np.float32(0) else turn


@inner
def _directions(
    size: int, x_m: Float32, y_m: Float32, z_m: Float32, limits: Float32, columns: int, r_m: Float32, part: Float32,
    column: NDArray[np.int32],
) -> None:  # fmt: skip
    """Range of each point of a block, 0 where it does not count, and its column."""
    nothing, steps, last = np.float32(0), np.float32(columns), np.int32(columns)
    least, most, shift = limits[0], limits[1], limits[2]
    for j in range(size):
        x, y, z = x_m[j], y_m[j], z_m[j]
        squared = x * x + y * y + z * z
        real = (squared > nothing) & (squared >= least) & (squared <= most)
        r_m[j] = np.sqrt(squared) if real else nothing
        part[j] = turn_of(x, y) if real else nothing
    for j in range(size):
        c = np.int32(part[j] * steps + shift) - np.int32(1)
        c = c + last if c < 0 else c
        column[j] = c - last if c >= last else c


@inner
def _turned(
    size: int, x_m: Float32, y_m: Float32, z_m: Float32, slot: NDArray[np.uint8], t: Float32, x_out: Float32,
    y_out: Float32, z_out: Float32,
) -> None:  # fmt: skip
    """Points of a block in base made upright, by the tilt of their time slots."""
    for j in range(size):
        x, y, z, s = x_m[j], y_m[j], z_m[j], np.float32(slot[j])
        x_out[j] = (t[0] + s * t[12]) * x + (t[1] + s * t[13]) * y + (t[2] + s * t[14]) * z
        y_out[j] = (t[4] + s * t[16]) * x + (t[5] + s * t[17]) * y + (t[6] + s * t[18]) * z
        z_out[j] = (t[8] + s * t[20]) * x + (t[9] + s * t[21]) * y + (t[10] + s * t[22]) * z + t[11]
