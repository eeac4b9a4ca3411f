"""From the ranges of all tags of a body to its track: robust filter, smoother over the whole log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.body.body_filter import (
    COVARIANCE,
    FILTERED,
    INNOVATION,
    STATE,
    BodyDynamics,
    filter_body,
    smooth_body,
    smooth_body_covariances,
)
from quadlog.positioning.heading.yaw_offset import UNKNOWN_YAW_STD_RAD
from quadlog.positioning.track.range_log import ACCELERATION_LASTS_S, VelocitySeries, sample_velocity
from quadlog.positioning.track.segments import LONG_STD, LOST_AFTER_S, SHORT_STD

YAW_RATE_STD_RADPS, YAW_RATE_LASTS_S = 0.5, 2.0
"""How fast walkers and trolleys turn, and for how long. On simulated walks 0.3 to 1 rad/s and 1 to 5 s do as well."""
START_STD = (0.5, 0.5, UNKNOWN_YAW_STD_RAD, 1.0, 1.0, YAW_RATE_STD_RADPS)
"""How well the first fixes are believed: hardly, because their ranges are used again."""


@dataclass(frozen=True, slots=True)
class BodyLog:
    """N ranges of the tags of one body in time order, at T instants; instant k has rows first_row[k]:first_row[k+1].

    anchor_m (N, 3): where the anchor
    stands, its height less the tag's, with the sign turned. lever_m (N, 2): where the tag sits, seen from the middle
    of the tags. range_m (N,): without biases. trusted: (N,) weights given beforehand. velocity_mps (T, 2) of the
    middle, with its variance (T,), infinite for none.
    """

    instant_ns: Int
    first_row: Int
    anchor_m: Float
    lever_m: Float
    range_m: Float
    trusted: Float
    velocity_mps: Float
    velocity_variance: Float
    range_std_m: float
    motion: BodyDynamics

    def rows(self, begin: int, end: int) -> slice:
        """The rows of the instants [begin, end)."""
        return slice(int(self.first_row[begin]), int(self.first_row[end]))


@dataclass(frozen=True, slots=True)
class BodySegment:
    """Instants [begin, end) of a log, tracked from one start (6,).

    weight (N,); filtered (T, FILTERED): what the filter wrote; states (T, 6), covariances (T, 6, 6): filtered or
    smoothed.
    """

    begin: int
    end: int
    start: Float
    weight: Float
    filtered: Float
    states: Float
    covariances: Float


def log_body(
    t_ns: Int,
    anchor_m: Float,
    lever_m: Float,
    range_m: Float,
    trusted: Float,
    *,
    range_std_m: float,
    acceleration_std_mps2: float,
    velocity: VelocitySeries | None = None,
    causal: bool = False,
) -> BodyLog:
    """The fields of BodyLog, from N ranges in time order; causal: of a velocity nothing is used before it was known."""
    instant_ns, first_row = np.unique(t_ns, return_index=True)
    return BodyLog(
        instant_ns,
        np.append(first_row, len(t_ns)),
        np.ascontiguousarray(anchor_m, dtype=np.float64),
        np.ascontiguousarray(lever_m, dtype=np.float64),
        np.ascontiguousarray(range_m, dtype=np.float64),
        np.ascontiguousarray(trusted, dtype=np.float64),
        *sample_velocity(velocity, instant_ns, causal=causal),
        float(range_std_m),
        BodyDynamics(float(acceleration_std_mps2**2 * ACCELERATION_LASTS_S), YAW_RATE_STD_RADPS, YAW_RATE_LASTS_S),
    )


def segment_bounds(instant_ns: Int, restart_ns: Int) -> list[tuple[int, int]]:
    """[begin, end) of the instants (T,) between gaps of LOST_AFTER_S and instants where the track begins again."""
    gaps = np.flatnonzero(np.diff(instant_ns) > LOST_AFTER_S * 1e9) + 1
    again = np.searchsorted(instant_ns, restart_ns)
    cuts = np.unique(np.concatenate([[0], gaps, again, [len(instant_ns)]])).astype(np.int64).tolist()
    return [(begin, end) for begin, end in pairwise(cuts) if begin < end]


def filter_segment(log: BodyLog, begin: int, end: int, start: Float) -> BodySegment:
    """The causal track of a segment: long residuals lose weight as 1/residual, as in `track_ranges`."""
    limits_m = LONG_STD * log.range_std_m, SHORT_STD * log.range_std_m
    return _filter(log, begin, end, start, log.trusted[log.rows(begin, end)], *limits_m)


def smooth_segment(log: BodyLog, segment: BodySegment) -> BodySegment:
    """The segment smoothed [RTS] with the weights given beforehand.

    Twice: the second time from where the first one starts, so that the first instants are linearised where the body
    was.
    """
    weight = log.trusted[log.rows(segment.begin, segment.end)]
    first = _smooth(log, segment, weight)
    return _smooth(log, replace(first, start=first.states[0]), weight)


def _smooth(log: BodyLog, segment: BodySegment, weight: Float) -> BodySegment:
    filtered = _filter(log, segment.begin, segment.end, segment.start, weight, np.inf, np.inf)
    instants, states = slice(segment.begin, segment.end), np.empty((segment.end - segment.begin, 6))
    t_s = seconds_since(log.instant_ns[instants], int(log.instant_ns[segment.begin]))
    velocity = log.velocity_mps[instants], log.velocity_variance[instants]
    smooth_body(t_s, *velocity, filtered.filtered, log.motion, states)
    return replace(filtered, states=states, covariances=smooth_body_covariances(t_s, filtered.filtered, log.motion))


def _filter(
    log: BodyLog, begin: int, end: int, start: Float, given_weight: Float, long_m: float, short_m: float
) -> BodySegment:
    rows, instants = log.rows(begin, end), slice(begin, end)
    weight, filtered = np.empty(rows.stop - rows.start), np.empty((end - begin, FILTERED))
    filter_body(
        seconds_since(log.instant_ns[instants], int(log.instant_ns[begin])),
        log.first_row[begin : end + 1] - rows.start,
        log.anchor_m[rows],
        log.lever_m[rows],
        log.range_m[rows],
        given_weight,
        log.velocity_mps[instants],
        log.velocity_variance[instants],
        start,
        np.square(START_STD),
        log.motion,
        log.range_std_m**2,
        long_m,
        short_m,
        weight,
        filtered,
    )
    covariances = filtered[:, COVARIANCE].reshape(-1, 6, 6)
    return BodySegment(begin, end, start, weight, filtered, filtered[:, STATE], covariances)


def predict_segment(log: BodyLog, segment: BodySegment) -> Float:
    """(N,) distance of each range's anchor from its tag, by the states of the segment."""
    rows = log.rows(segment.begin, segment.end)
    counts = np.diff(log.first_row[segment.begin : segment.end + 1])
    x_m, y_m, yaw_rad = np.repeat(segment.states[:, :3], counts, axis=0).T
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    ahead_m, left_m = log.lever_m[rows].T
    anchor_x_m, anchor_y_m, down_m = log.anchor_m[rows].T
    offset_m = x_m + cos * ahead_m - sin * left_m - anchor_x_m, y_m + sin * ahead_m + cos * left_m - anchor_y_m, down_m
    return np.sqrt(sum(each**2 for each in offset_m))


def innovations(log: BodyLog, segment: BodySegment) -> tuple[Int, Float]:
    """(T,) ranges of each instant, and the squared innovation per range."""
    count = np.diff(log.first_row[segment.begin : segment.end + 1])
    return count, segment.filtered[:, INNOVATION] / count
