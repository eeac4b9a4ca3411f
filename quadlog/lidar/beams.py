"""Which beam each point came from: as the driver numbers them, or as the elevations show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
_POINTS_FOR_PHASE = 1000
# Sines of elevations in bins of 0.06 degrees at the horizon.
_BINS = 2000
_BIN_RAD = np.deg2rad(1.5)
_FEWEST_IN_BEAM, _LEAST_SHARE_IN_BEAMS = 20, 0.95


@dataclass(frozen=True, slots=True)
class Beams:
    """beam: (N,) uint16 number of each point's beam; row: (beams,) its row, from the lowest in base up, -1 if unused.

    descending: (rows,) whether the beam points below the lidar's own horizon. columns: steps of a full turn;
    phase: where within a step, in [-0.5, 0.5], most points lie.
    """

    beam: NDArray[np.uint16]
    row: Int
    descending: NDArray[np.bool_]
    columns: int
    phase: float


def beams_by_ring(polar: Polar, ring: NDArray[np.uint16] | None, upright: bool) -> Beams | None:
    """Beams as the driver numbers them, in whatever order; None where the numbers do not go with elevations."""
    if ring is None or ring.shape != polar.range_m.shape:
        return None
    return _sorted_beams(polar, ring.astype(np.uint16, copy=False), upright)


def beams_by_elevation(polar: Polar, upright: bool) -> Beams | None:
    """Beams as the histogram of elevations shows them, with empty bins between; None where it shows none."""
    known = polar.range_m > 0
    bins = np.minimum(((polar.sine + 1) * (_BINS / 2)).astype(np.int64), _BINS - 1)
    count = np.bincount(bins[known], minlength=_BINS)
    filled = np.concatenate([[False], count > 0, [False]])
    edge = np.flatnonzero(filled[1:] != filled[:-1])
    first, last = edge[::2], edge[1::2]
    total = np.add.reduceat(np.append(count, 0), first) if len(first) else np.zeros(0)
    real = total >= _FEWEST_IN_BEAM
    if not 2 <= np.count_nonzero(real) <= MOST_BEAMS or total[real].sum() < _LEAST_SHARE_IN_BEAMS * total.sum():
        return None
    number = np.full(_BINS, NO_BEAM, dtype=np.uint16)
    for beam, (low, high) in enumerate(zip(first[real], last[real], strict=True)):
        number[low:high] = beam
    return _sorted_beams(polar, number[bins], upright)


def beams_by_bins(polar: Polar) -> Beams:
    """Beams that are none: points in bins of elevation, as many columns as leave about a point to a cell.

    For clouds without beams, by directions along base's axes from where the lidar stands.
    """
    known = polar.range_m > 0
    number = ((np.arcsin(np.clip(polar.sine, -1, 1)) + np.pi / 2) / _BIN_RAD).astype(np.uint16)
    used = np.unique(number[known])
    row = np.full(int(np.pi / _BIN_RAD) + 2, -1, dtype=np.int64)
    row[used] = np.arange(len(used))
    per_turn = np.count_nonzero(known) / max(len(used), 1)
    columns = int(np.clip(per_turn, 2 * FEWEST_COLUMNS, MOST_COLUMNS / 4))
    return Beams(number, row, (used + 0.5) * _BIN_RAD < np.pi / 2, columns, 0.0)


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
    row = np.full(MOST_BEAMS, -1, dtype=np.int64)
    row[used[order]] = np.arange(len(used))
    descending = mean[order] < 0 if upright else mean[order] > 0
    columns = _columns(found.arcs[used])
    return Beams(beam, row, descending, columns, _phase(polar, columns))


def _columns(arcs: Int) -> int:
    """Steps of a full turn, by the beam that fills the arcs (beams, _ARCS) it reaches best."""
    held, reached = arcs.sum(axis=1), np.count_nonzero(arcs, axis=1)
    # A beam that reaches few arcs may see some of them twice, as through leaves.
    wide = 2 * reached >= reached.max()
    return min(max(round(float((held[wide] / reached[wide]).max()) * _ARCS), FEWEST_COLUMNS), MOST_COLUMNS)


def _phase(polar: Polar, columns: int) -> float:
    """Where in a step the points lie, from some of them; 0 where they lie anywhere.

    Steps that lie on the edge between two columns would be rounded into either, two points into one cell and none
    into the next.
    """
    some = slice(None, None, max(len(polar.turn) // _POINTS_FOR_PHASE, 1))
    turn = polar.turn[some][polar.range_m[some] > 0].astype(np.float64)
    mean = np.exp(2j * np.pi * columns * turn).mean() if len(turn) else 0.0
    return float(np.angle(mean) / (2 * np.pi)) if abs(mean) > 0.5 else 0.0


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


@njit(cache=True, error_model="numpy")
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
