"""The ranges of one tag as the filter takes them, and a stretch of them filtered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.kalman import Motion, filter_ranges

START_STD = (0.5, 0.5, 1.0, 1.0)
"""How well a first fix and standing still are believed, in m and m/s; wide, because the fix's ranges are used again."""


@dataclass(frozen=True, slots=True)
class RangeLog:
    """All N ranges of a tag in time order, at T instants; what they are to, and what is assumed of them.

    Instant k has rows first_row[k]:first_row[k+1]; velocity_mps (T, 2) and its variance (T,), infinite for none.
    fix_t_ns (F,), fix_m (F, 2): fixes, and when each was known.
    """

    instant_ns: Int
    first_row: Int
    anchor: Int
    range_m: Float
    velocity_mps: Float
    velocity_variance: Float
    fix_t_ns: Int
    fix_m: Float
    anchors_m: Float
    range_std_m: float
    motion: Motion

    @property
    def where(self) -> list[int]:
        """The coordinates of the place within a state."""
        return [0, 1, 4] if self.motion.height_std_m > 0 else [0, 1]


@dataclass(frozen=True, slots=True)
class Stretch:
    """Instants [begin, end) of a log, tracked from one fix on: states (T, n), covariances (T, n, n), weight (N,).

    start: the state before the first range; restarted: it begins where another track had lost the tag.
    """

    begin: int
    end: int
    start: Float
    restarted: bool
    states: Float
    covariances: Float
    weight: Float


def filter_stretch(
    log: RangeLog, begin: int, end: int, start: Float, given_weight: Float, long_m: float, short_m: float
) -> tuple[Float, Float, Float]:
    """States, covariances and weights of instants [begin, end) from a start state (n,)."""
    std = np.append(START_STD, [log.motion.height_std_m] * (len(log.where) - 2))
    rows = slice(log.first_row[begin], log.first_row[end])
    return filter_ranges(
        seconds_since(log.instant_ns[begin:end], int(log.instant_ns[begin])),
        log.first_row[begin : end + 1] - rows.start,
        log.anchor[rows],
        log.range_m[rows],
        log.anchors_m,
        start,
        np.diag(std**2),
        given_weight,
        log.range_std_m,
        log.motion,
        long_m,
        short_m,
        log.velocity_mps[begin:end],
        log.velocity_variance[begin:end],
    )


def predict_rows(log: RangeLog, stretch: Stretch) -> tuple[Float, Float]:
    """(N,) distance of each range's anchor from the state at its instant, and (N, D) the direction from it."""
    rows = log.first_row[stretch.begin : stretch.end + 1]
    place_m = np.repeat(places(log, stretch.states), np.diff(rows), axis=0)
    offset_m = place_m - log.anchors_m[log.anchor[rows[0] : rows[-1]]]
    distance_m: Float = np.sqrt((offset_m**2).sum(axis=1))
    return distance_m, offset_m[:, : len(log.where)] / np.maximum(distance_m, 1e-9)[:, None]


def places(log: RangeLog, states: Float) -> Float:
    """(T, 3) in map."""
    place_m = np.full((len(states), 3), log.motion.height_m)
    place_m[:, : len(log.where)] = states[:, log.where]
    return place_m
