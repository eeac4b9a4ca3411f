"""Which beam each point came from: as the driver numbers them, or as the elevations show."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.lidar.polar import Polar
from quadlog.messages import Float, Float32, Int

MOST_BEAMS = 256
FEWEST_COLUMNS, MOST_COLUMNS = 90, 3600
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


@dataclass(frozen=True, slots=True)
class Beams:
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

    @property
    def rows(self) -> int:
        """Beams that return anything."""
        return len(self.descending)


def beams_by_ring(polar: Polar, ring: NDArray[np.uint16] | None, upright: bool) -> Beams | None:
    """Beams as the driver numbers them, in whatever order; None where the numbers do not go with elevations."""
    if ring is None or ring.shape != polar.range_m.shape:
        return None
    return _sorted_beams(polar, ring.astype(np.uint16, copy=False), upright)


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
    beams = _sorted_beams(polar, number[bins], upright)
    if beams is None:
        return None
    number = np.minimum(number, len(beams.first_cell) - 1)
    return replace(beams, by_elevation=True, first_cell=beams.first_cell[number], sine=beams.sine[number])


def beams_by_bins(range_m: Float32, sine: Float32) -> tuple[Beams, NDArray[np.uint16]]:
    """Beams that are none, and the number (N,) of each point's: bins of elevation, and about a point to a cell.

    For clouds without beams; range_m, sine: (N,) by directions along base's axes from where the lidar stands.
    """
    known = range_m > 0
    number = ((np.arcsin(np.clip(sine, -1, 1)) + np.pi / 2) / _BIN_RAD).astype(np.uint16)
    used = np.unique(number[known])
    per_turn = np.count_nonzero(known) / max(len(used), 1)
    columns = int(np.clip(per_turn, 2 * FEWEST_COLUMNS, MOST_COLUMNS / 4))
    first_cell = np.full(int(np.pi / _BIN_RAD) + 2, -1, dtype=np.int32)
    first_cell[used] = np.arange(len(used)) * columns
    below = (used + 0.5) * _BIN_RAD < np.pi / 2
    return Beams(first_cell, False, below, columns, np.zeros(len(first_cell), np.float32), np.inf), number


def phase_and_strangers(
    xyz_m: tuple[Float32, Float32, Float32], key: NDArray[np.uint16], beams: Beams, ranges_m: tuple[float, float]
) -> tuple[float, float]:
    """Where in a step the points lie, from some of them, and the share of these that do not lie on their beams.

    The phase is in [-0.5, 0.5]. Steps that lie on the edge between two columns would be rounded into either, two
    points into one cell and none into the next. It is 0 where the points lie anywhere in a step.
    """
    found = np.zeros(4)
    limits = np.array([max(ranges_m[0], 1e-9) ** 2, min(ranges_m[1], 1e18) ** 2, beams.tolerance])
    x_m, y_m, z_m = xyz_m
    _sample(x_m, y_m, z_m, key, beams.first_cell, beams.sine, beams.by_elevation, beams.columns, limits, found)
    cos, sin, n, strangers = found.tolist()
    if n == 0:
        return 0.0, 0.0
    phase = math.atan2(sin, cos) / (2 * math.pi) if math.hypot(cos, sin) > 0.5 * n else 0.0
    return phase, strangers / n


@kernel
def _sample(
    x_m: Float32,
    y_m: Float32,
    z_m: Float32,
    key: NDArray[np.uint16],
    first_cell: NDArray[np.int32],
    sines: Float32,
    by_elevation: bool,
    columns: int,
    limits: Float,
    found: Float,
) -> None:
    """Sums of the cosine and the sine of the phase, points looked at, and those of them that are on no beam."""
    last_key = len(first_cell) - 1
    # An odd step meets every beam of a sweep that is sent column by column.
    for i in range(0, len(x_m), max(len(x_m) // _POINTS_FOR_PHASE, 1) | 1):
        x, y, z = np.float64(x_m[i]), np.float64(y_m[i]), np.float64(z_m[i])
        squared = x * x + y * y + z * z
        if not (squared >= limits[0] and squared <= limits[1]):
            continue
        turn_rad = math.atan2(y, x) * columns
        found[0] += math.cos(turn_rad)
        found[1] += math.sin(turn_rad)
        found[2] += 1.0
        sine = z / math.sqrt(squared)
        number = int((sine + 1.0) * (ELEVATION_BINS / 2)) if by_elevation else int(key[i])
        number = min(number, last_key)
        strange = first_cell[number] < 0 or (not by_elevation and not abs(sine - sines[number]) <= limits[2])
        found[3] += 1.0 if strange else 0.0


def _sorted_beams(polar: Polar, beam: NDArray[np.uint16], upright: bool) -> Beams | None:
    found = _statistics(polar, beam)
    used = np.flatnonzero(found.points)
    if len(used) == 0:
        return None
    n = found.points[used]
    mean = found.first[used] + found.total[used] / n
    scatter = np.sqrt(max(np.sum(found.squares[used] - found.total[used] ** 2 / n), 0.0) / n.sum())
    order = np.argsort(mean if upright else -mean, kind="stable")
    gaps = np.sort(np.abs(np.diff(mean[order])))
    gap = gaps[len(gaps) // 2] if len(gaps) else _FLAT_SCATTER / _LARGEST_SCATTER
    if scatter > _LARGEST_SCATTER * gap:
        return None
    descending = mean[order] < 0 if upright else mean[order] > 0
    columns = _columns(found.arcs[used])
    first_cell = np.full(MOST_BEAMS + 1, -1, dtype=np.int32)
    first_cell[used[order]] = np.arange(len(used)) * columns
    sine = np.full(MOST_BEAMS + 1, np.nan, dtype=np.float32)
    sine[used] = mean
    return Beams(first_cell, False, descending, columns, sine, max(gap * _STRANGE, _FLAT_SCATTER))


def _columns(arcs: Int) -> int:
    """Steps of a full turn, by the beam that fills the arcs (beams, _ARCS) it reaches best."""
    held, reached = arcs.sum(axis=1), np.count_nonzero(arcs, axis=1)
    # A beam that reaches few arcs may see some of them twice, as through leaves.
    wide = 2 * reached >= reached.max()
    return min(max(round(float((held[wide] / reached[wide]).max()) * _ARCS), FEWEST_COLUMNS), MOST_COLUMNS)


class _Statistics(NamedTuple):
    """Per beam: points, sum and squares of their sines about the first, the first, and points in each arc."""

    points: Int
    total: Float
    squares: Float
    first: Float
    arcs: Int


def _statistics(polar: Polar, beam: NDArray[np.uint16]) -> _Statistics:
    beams = min(int(beam.max(initial=0)) + 1, MOST_BEAMS)
    total, squares, first = np.zeros((3, beams))
    statistics = _Statistics(np.zeros(beams, np.int64), total, squares, first, np.zeros((beams, _ARCS), np.int64))
    _gather(polar.range_m, polar.sine, polar.turn, beam, *statistics)
    return statistics


@kernel
def _gather(
    range_m: Float32,
    sine: Float32,
    turn: Float32,
    beam: NDArray[np.uint16],
    count: Int,
    total: Float,
    squares: Float,
    first: Float,
    arcs: Int,
) -> None:
    # A number too large for a beam names none.
    for i in range(len(range_m)):
        b = np.int64(beam[i])
        if range_m[i] == 0 or b >= len(count):
            continue
        if count[b] == 0:
            first[b] = sine[i]
        # About the first, so that the squares of a beam's tiny scatter are not lost in rounding.
        apart = sine[i] - first[b]
        count[b] += 1
        total[b] += apart
        squares[b] += apart * apart
        arcs[b, int(turn[i] * _ARCS)] += 1
