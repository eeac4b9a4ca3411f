"""A scan as a range image: the beams of a sensor that no message describes, points laid on them, and the isolation
filter: a return without neighbours at a similar range is an outlier.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import PointClass, Returns
from quadlog.messages import Float, Float32, Int


class Polar(NamedTuple):
    """range_m: (N,) from the lidar, 0 for no return. sine: (N,) of the elevation; turn: (N,) azimuth, [0, 1)."""

    range_m: Float32
    sine: Float32
    turn: Float32


def to_polar(xyz_m: Float32, ranges_m: tuple[float, float]) -> Polar:
    """Points x, y, z (3, N) by direction; only ranges from the least to the most of ranges_m are returns."""
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
Keys = NDArray[np.uint16]


class Beams(NamedTuple):
    """How one lidar's points go into an image; it holds as long as the sensor and its driver stay what they are.

    row: (keys + 1,) of each beam number, -1 for those without a beam; the last entry stands for all numbers beyond.
    descending: (rows,) from the lowest in base up, whether the beam points below the lidar's own horizon. columns:
    steps of a full turn. sine: (keys + 1,) of each beam's elevation, NaN where there is no beam; tolerance: how far
    from it a point of the beam may lie.
    """

    row: NDArray[np.int16]
    descending: NDArray[np.bool_]
    columns: int
    sine: Float32
    tolerance: float


def beams_by_number(polar: Polar, key: Keys, upright: bool) -> Beams | None:
    """Beams by their numbers (N,), in any order; None where these do not match the elevations."""
    known = (polar.range_m > 0) & (key < MOST_BEAMS)
    number, sine = key[known].astype(np.int64), polar.sine[known].astype(np.float64)
    if len(number) == 0:
        return None
    points = np.bincount(number, minlength=MOST_BEAMS + 1)
    mean = np.bincount(number, sine, MOST_BEAMS + 1) / np.where(points > 0, points, np.nan)
    scatter = np.sqrt(np.mean((sine - mean[number]) ** 2))
    used, up = np.flatnonzero(points), mean if upright else -mean
    order = used[np.argsort(up[used], kind="stable")]
    gaps = np.sort(np.diff(up[order]))
    gap = gaps[len(gaps) // 2] if len(gaps) else _FLAT_SCATTER / _LARGEST_SCATTER
    if scatter > _LARGEST_SCATTER * gap:
        return None
    row = np.full(MOST_BEAMS + 1, -1, dtype=np.int16)
    row[order] = np.arange(len(order))
    return Beams(
        row,
        up[order] < 0,
        _columns(number, polar.turn[known]),
        mean.astype(np.float32),
        max(gap * _STRANGE, _FLAT_SCATTER),
    )


def elevation_keys(sine: Float32) -> Keys:
    """Bins (N,) of elevations, which stand for beam numbers where a driver sends none."""
    return np.minimum((sine + 1) * (ELEVATION_BINS / 2), ELEVATION_BINS - 1).astype(np.uint16)


def beams_by_elevation(polar: Polar, upright: bool) -> Beams | None:
    """Beams of `elevation_keys` as their histogram shows them, with empty bins between; None where it shows none."""
    bins = elevation_keys(polar.sine)
    count = np.bincount(bins[polar.range_m > 0], minlength=ELEVATION_BINS)
    filled = np.concatenate([[False], count > 0, [False]])
    edge = np.flatnonzero(filled[1:] != filled[:-1])
    first, last = edge[::2], edge[1::2]
    total = np.add.reduceat(np.append(count, 0), first) if len(first) else np.zeros(0)
    real = total >= _FEWEST_IN_BEAM
    if not 2 <= np.count_nonzero(real) <= MOST_BEAMS or total[real].sum() < _LEAST_SHARE_IN_BEAMS * total.sum():
        return None
    number = np.full(ELEVATION_BINS + 1, MOST_BEAMS, dtype=np.uint16)
    for beam, (low, high) in enumerate(zip(first[real], last[real], strict=True)):
        number[low:high] = beam
    beams = beams_by_number(polar, number[bins], upright)
    return beams and beams._replace(row=beams.row[number], sine=beams.sine[number])


def beams_by_bins(range_m: Float32, sine: Float32) -> tuple[Beams, Keys]:
    """Bins of elevation in place of beams, and the bin (N,) of each point: about a point to a cell.

    For clouds without beams; range_m, sine: (N,) by directions along base's axes from where the lidar stands.
    """
    known = range_m > 0
    key = ((np.arcsin(np.clip(sine, -1, 1)) + np.pi / 2) / _BIN_RAD).astype(np.uint16)
    used = np.unique(key[known])
    per_turn = np.count_nonzero(known) / max(len(used), 1)
    columns = int(np.clip(per_turn, 5 * FEWEST_COLUMNS, MOST_COLUMNS / 4))
    row = np.full(int(np.pi / _BIN_RAD) + 2, -1, dtype=np.int16)
    row[used] = np.arange(len(used))
    below = (used + 0.5) * _BIN_RAD < np.pi / 2
    return Beams(row, below, columns, np.zeros(len(row), np.float32), np.inf), key


def phase_and_strangers(xyz_m: Float32, key: Keys, beams: Beams, ranges_m: tuple[float, float]) -> tuple[float, float]:
    """Where in a step the points lie, from some of them, and the share of these that do not lie on their beams.

    The phase is in [-0.5, 0.5]. Steps that lie on the edge between two columns would be rounded into either, two
    points into one cell and none into the next. It is 0 where the points lie anywhere in a step.
    """
    # An odd step meets every beam of a sweep that is sent column by column.
    step = max(len(key) // _POINTS_FOR_PHASE, 1) | 1
    polar = to_polar(xyz_m[:, ::step], ranges_m)
    real = np.flatnonzero(polar.range_m)
    number = np.minimum(key[::step][real], len(beams.row) - 1)
    off_beam = np.abs(polar.sine[real] - beams.sine[number]) > beams.tolerance
    turn = np.exp(2j * np.pi * beams.columns * polar.turn[real].astype(np.float64)).sum()
    phase = float(np.angle(turn)) / (2 * np.pi) if abs(turn) > 0.5 * len(real) else 0.0
    return phase, np.count_nonzero(off_beam) / max(len(real), 1)


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


class Image(NamedTuple):
    """Cells of the nearest return of each beam and step, and in which of them each point lies.

    range_m: (rows, columns) of the nearest returns, 0 where there is none; behind_m: range of the farthest return
    behind it, or 0. distance_m, z_m: horizontal distance and height in base, as `isolate` smooths them. point_range_m:
    (N,) of the points, 0 of those that are no returns; cell: theirs, counted row by row; those on no beam lie in row
    -1.
    """

    range_m: Float32
    behind_m: Float32
    distance_m: Float32
    z_m: Float32
    point_range_m: Float32
    cell: NDArray[np.int32]


def lay(
    xyz_m: Float32, key: Keys, slot: NDArray[np.uint8], beams: Beams, transforms: Float, ranges_m: tuple[float, float],
    phase: float,
) -> tuple[Image, Returns, int]:  # fmt: skip
    """The image of points x, y, z (3, N) of the lidar's frame, their places, and how many have no cell of their own.

    key: (N,) beam numbers. transforms: (2, 4, 4) from the lidar's frame to base made upright, of which base's x and y
    of the lidar are left out, and their change per time slot. ranges_m: the least and the most that count. phase: where
    within a step the points lie. Heights and labels are left open.
    """
    n, shape = len(key), (len(beams.descending), beams.columns)
    first = beams.row.astype(np.int32) * beams.columns
    limits = np.array([ranges_m[0] ** 2, min(ranges_m[1] ** 2, 3e38), 1.5 - phase], np.float32)
    returns = Returns._make([*np.empty((4, n), np.float32), np.empty(n, np.uint8), slot])
    (near_m, behind_m), (distance_m, z_m) = np.zeros((2, *shape), np.float32), np.empty((2, *shape), np.float32)
    image = Image(near_m, behind_m, distance_m, z_m, np.empty(n, np.float32), np.empty(n, np.int32))
    turning = transforms[:, :3].astype(np.float32).ravel()
    return image, returns, _lay(xyz_m, key, first, turning, limits, image, returns)


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


@kernel
def _lay(
    xyz_m: Float32, key: Keys, first: NDArray[np.int32], t: Float32, limits: Float32, image: Image, returns: Returns
) -> int:
    """How many returns have no cell of their own. first: the first cell of each beam number.

    The first two loops have no branches and are in 32 bits, so that they become vector instructions.
    """
    x_m, y_m, z_m, slot, cell, range_m = xyz_m[0], xyz_m[1], xyz_m[2], returns.slot, image.cell, image.point_range_m
    dx_m, dy_m, base_z_m, columns = returns.dx_m, returns.dy_m, returns.z_m, image.range_m.shape[1]
    nothing, steps, last, last_key = np.float32(0), np.float32(columns), np.int32(columns), len(first) - 1
    least, most, shift = limits[0], limits[1], limits[2]
    for i in range(len(key)):
        x, y, z = x_m[i], y_m[i], z_m[i]
        squared = x * x + y * y + z * z
        real = (squared > nothing) & (squared >= least) & (squared <= most)
        range_m[i] = np.sqrt(squared) if real else nothing
        turn = turn_of(x, y) if real else nothing
        c = np.int32(turn * steps + shift) - np.int32(1)
        c = c + last if c < 0 else c
        cell[i] = c - last if c >= last else c
    for i in range(len(key)):
        x, y, z, s = x_m[i], y_m[i], z_m[i], np.float32(slot[i])
        dx_m[i] = (t[0] + s * t[12]) * x + (t[1] + s * t[13]) * y + (t[2] + s * t[14]) * z
        dy_m[i] = (t[4] + s * t[16]) * x + (t[5] + s * t[17]) * y + (t[6] + s * t[18]) * z
        base_z_m[i] = (t[8] + s * t[20]) * x + (t[9] + s * t[21]) * y + (t[10] + s * t[22]) * z + t[11]
    nearest_m, behind_m, cell_z_m = image.range_m.reshape(-1), image.behind_m.reshape(-1), image.z_m.reshape(-1)
    hidden = 0
    for i in range(len(key)):
        k, r = first[min(int(key[i]), last_key)] + cell[i], range_m[i]
        cell[i] = k
        if k < 0 or r == nothing:
            hidden += r > nothing
            continue
        at = np.uint32(k)
        before = nearest_m[at]
        if before > nothing:
            hidden += 1
            behind_m[at] = max(behind_m[at], max(before, r))
        if before == nothing or r < before:
            nearest_m[at], cell_z_m[at] = r, base_z_m[i]
    return hidden


WINDOW, ROWS, SUPPORTERS = 4, 2, 2
NEAR_M, NEAR_PER_M = np.float32(0.10), np.float32(0.025)
"""Supporters lie within NEAR_M + NEAR_PER_M r, WINDOW columns and, where the own row has too few, ROWS rows.

Chosen on seed 100 of tests.lab.labelled_scans; never reported on that seed.
"""
# Returns of one surface, four standard deviations of a range apart at most, are averaged.
_SAME_SURFACE_M = np.float32(0.08)
# Range of an empty cell in comparisons: far from every other.
_FAR_OFF_M = np.float32(-1e6)
_INVALID, _, _OUTLIER, _, _OBSTACLE = (np.uint8(each) for each in PointClass)


@inner
def wrapped(column: int, columns: int) -> int:
    """A column less than a turn beyond either end."""
    return column + columns if column < 0 else (column - columns if column >= columns else column)


@inner
def _supported(image: Image, row: int, column: int, r: float) -> bool:
    """Whether SUPPORTERS returns about a cell lie near range r, or two at its sides that a straight line joins.

    The line is ground far away, where the range changes fast along the beam. The cell's own returns do not count.
    """
    range_m, (rows, columns) = image.range_m, image.range_m.shape
    near_m, half, found = NEAR_M + NEAR_PER_M * r, np.float32(0.5), 0
    for k in range(1, WINDOW + 1):
        left, right = range_m[row, wrapped(column - k, columns)], range_m[row, wrapped(column + k, columns)]
        if left > 0 and right > 0 and abs(half * (left + right) - r) <= near_m:
            return True
    for i in range(max(row - ROWS, 0), min(row + ROWS + 1, rows)):
        for k in range(-WINDOW, WINDOW + 1):
            c = wrapped(column + k, columns)
            near, far = range_m[i, c], image.behind_m[i, c]
            if near > 0 and (k != 0 or i != row):
                found += int(abs(near - r) <= near_m) + int(far > near and abs(far - r) <= near_m)
    return found >= SUPPORTERS


@kernel
def isolate(image: Image, lidar_z: float, label: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The isolation filter: label every return an obstacle where neighbours support it, else an outlier.

    A return that lies behind another one in its cell, but near it, is as that one. Returns which cells are supported
    (rows, columns), and fills distance_m and z_m, smoothed by the mean range of the same surface within the window: a
    third of the noise, so that slopes between beams are significant. lidar_z: the lidar's own height in base, float32.
    """
    one, none, (rows, columns) = np.float32(1), np.float32(0), image.range_m.shape
    good, wide = np.empty((rows, columns), np.bool_), np.empty(columns + 2 * WINDOW, np.float32)
    for row in range(rows):
        ranges, distance, z, here = image.range_m[row], image.distance_m[row], image.z_m[row], good[row]
        for c in range(columns):
            wide[WINDOW + c] = ranges[c] if ranges[c] > none else _FAR_OFF_M
        for k in range(WINDOW):
            wide[k], wide[WINDOW + columns + k] = wide[columns + k], wide[WINDOW + k]
        # Without branches, so that it becomes vector instructions; LLVM unrolls the inner loop.
        for c in range(columns):
            r = wide[c + WINDOW]
            near_m = NEAR_M + NEAR_PER_M * r
            found, same, total = none, none, none
            for k in range(2 * WINDOW + 1):
                apart = wide[c + k] - r
                found += one if abs(apart) <= near_m else none
                alike = abs(apart) <= _SAME_SURFACE_M
                same += one if alike else none
                total += apart if alike else none
            scale, up = one + total / (same * r), z[c] - lidar_z
            distance[c] = np.sqrt(max(r * r - up * up, none)) * scale if r > none else none
            z[c] = lidar_z + up * scale if r > none else none
            # The return itself is among those found.
            here[c] = (r > none) & (found > SUPPORTERS)
        for c in range(columns):
            if not here[c] and ranges[c] > none:
                here[c] = _supported(image, row, c, ranges[c])
    ranges, flat = image.range_m.reshape(-1), good.reshape(-1)
    for i in range(len(label)):
        cell, r = image.cell[i], image.point_range_m[i]
        if r == none:
            label[i] = _INVALID
            continue
        real = cell < 0
        if not real:
            at = np.uint32(cell)
            real = flat[at] if shares_cell(r, ranges[at]) else _supported(image, cell // columns, cell % columns, r)
        label[i] = _OBSTACLE if real else _OUTLIER
    return good


@inner
def shares_cell(r: np.float32, nearest: np.float32) -> np.bool_:
    """Whether a return at range r is as near as the nearest one in its cell."""
    return r - nearest <= NEAR_M + NEAR_PER_M * r
