"""From the ranges of all tags of a body to its track: robust filter, smoother over the whole log, and its honesty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from quadlog.geometry import seconds_since, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.body.body_filter import (
    COVARIANCE,
    FILTERED,
    INNOVATION,
    STATE,
    BodyDynamics,
    filter_body,
    smooth_body,
)
from quadlog.positioning.epochs import thin_links
from quadlog.positioning.heading.yaw_offset import UNKNOWN_YAW_STD_RAD
from quadlog.positioning.track.range_log import ACCELERATION_LASTS_S, VelocitySeries, sample_velocity
from quadlog.positioning.track.segments import LONG_STD, LOST_AFTER_S, SHORT_STD

YAW_RATE_STD_RADPS, YAW_RATE_LASTS_S = 0.5, 2.0
"""How fast walkers and trolleys turn, and for how long. On simulated walks 0.3 to 1 rad/s and 1 to 5 s do as well."""
MOST_GROUPS, MOST_SLOTS = 16, 5000
"""Anchors are left out in so many groups at most, of a log thinned to so many slots."""
START_STD = (0.5, 0.5, UNKNOWN_YAW_STD_RAD, 1.0, 1.0, YAW_RATE_STD_RADPS)
"""How well the first fixes are believed: hardly, because their ranges are used again."""


@dataclass(frozen=True, slots=True)
class BodyLog:
    """N ranges of the tags of one body in time order, at T instants; instant k has rows first_row[k]:first_row[k+1].

    link, anchor: (N,) numbers of the pair of tag and anchor, and of the anchor. anchor_m (N, 3): where the anchor
    stands, its height less the tag's, with the sign turned. lever_m (N, 2): where the tag sits, seen from the middle
    of the tags. range_m (N,): without biases. trusted: (N,) weights given beforehand. velocity_mps (T, 2) of the
    middle, with its variance (T,), infinite for none.
    """

    instant_ns: Int
    first_row: Int
    link: Int
    anchor: Int
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
    link: Int,
    anchor: Int,
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
        link,
        anchor,
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
    n, instants = segment.end - segment.begin, slice(segment.begin, segment.end)
    states, covariances = np.empty((n, 6)), np.empty((n, 6, 6))
    t_s = seconds_since(log.instant_ns[instants], int(log.instant_ns[segment.begin]))
    velocity = log.velocity_mps[instants], log.velocity_variance[instants]
    smooth_body(t_s, *velocity, filtered.filtered, log.motion, states, covariances)
    return replace(filtered, states=states, covariances=(covariances + covariances.transpose(0, 2, 1)) / 2)


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


def _instants_of_rows(log: BodyLog, segment: BodySegment) -> Int:
    counts = np.diff(log.first_row[segment.begin : segment.end + 1])
    return np.repeat(np.arange(segment.begin, segment.end), counts)


def predict_segment(log: BodyLog, segment: BodySegment) -> Float:
    """(N,) distance of each range's anchor from its tag, by the states of the segment."""
    distance_m, _ = _directions(log, segment)
    return distance_m


def innovations(log: BodyLog, segment: BodySegment) -> tuple[Int, Float]:
    """(T,) ranges of each instant, and the squared innovation per range."""
    count = np.diff(log.first_row[segment.begin : segment.end + 1])
    return count, segment.filtered[:, INNOVATION] / count


def _directions(log: BodyLog, segment: BodySegment) -> tuple[Float, Float]:
    """Distances (N,) of the rows, and how each changes with x, y and yaw (N, 3)."""
    rows = log.rows(segment.begin, segment.end)
    state = segment.states[_instants_of_rows(log, segment) - segment.begin]
    cos, sin = np.cos(state[:, 2]), np.sin(state[:, 2])
    ahead_m, left_m = log.lever_m[rows].T
    arm_m = np.stack([cos * ahead_m - sin * left_m, sin * ahead_m + cos * left_m], axis=1)
    offset_m = state[:, :2] + arm_m - log.anchor_m[rows, :2]
    distance_m = np.maximum(np.sqrt((offset_m**2).sum(axis=1) + log.anchor_m[rows, 2] ** 2), 1e-9)
    unit = offset_m / distance_m[:, None]
    turn = unit[:, 1] * arm_m[:, 0] - unit[:, 0] * arm_m[:, 1]
    return distance_m, np.column_stack([unit, turn])


def thin_body(log: BodyLog, weight: Float) -> BodyLog:
    """The log with at most one range of each link in a slot, those with these weights (N,) given beforehand."""
    t_ns = np.repeat(log.instant_ns, np.diff(log.first_row))
    kept = thin_links(t_ns, log.link, MOST_SLOTS)
    instant_ns, first_row = np.unique(t_ns[kept], return_index=True)
    at = np.searchsorted(log.instant_ns, instant_ns)
    return replace(
        log,
        instant_ns=instant_ns,
        first_row=np.append(first_row, len(kept)),
        link=log.link[kept],
        anchor=log.anchor[kept],
        anchor_m=log.anchor_m[kept],
        lever_m=log.lever_m[kept],
        range_m=log.range_m[kept],
        trusted=weight[kept],
        velocity_mps=log.velocity_mps[at],
        velocity_variance=log.velocity_variance[at],
    )


def lasting_spread(log: BodyLog, segments: list[BodySegment], bias_m2: Float) -> Float:
    """(3, 3) covariance of x, y and yaw from errors that last, mean over the log.

    What smoothed tracks differ by when anchors are left out in turn (delete-one jackknife, with biases kept), and
    G P G^T of biases with variances P (links,), G = (H^T H)^-1 H^T being what errors of the ranges do to a pose.
    """
    weight = np.zeros(len(log.range_m))
    for segment in segments:
        weight[log.rows(segment.begin, segment.end)] = segment.weight
    thin = thin_body(log, weight)
    starts_ns = np.array([log.instant_ns[segment.begin] for segment in segments])
    bounds = segment_bounds(thin.instant_ns, starts_ns)
    begins_ns = thin.instant_ns[[begin for begin, _ in bounds]]
    of = (np.searchsorted(starts_ns, begins_ns, side="right") - 1).clip(0)
    whole = [
        _smooth(thin, replace(segments[i], begin=begin, end=end, start=segments[i].states[0]), _given(thin, begin, end))
        for (begin, end), i in zip(bounds, of, strict=True)
    ]
    return _jackknife(thin, whole) + _bias_covariance(thin, whole, bias_m2)


def _given(log: BodyLog, begin: int, end: int) -> Float:
    weight: Float = log.trusted[log.rows(begin, end)]
    return weight


def _jackknife(log: BodyLog, segments: list[BodySegment]) -> Float:
    anchors = np.unique(log.anchor)
    groups = np.array_split(anchors, min(len(anchors), MOST_GROUPS))
    if len(groups) < 3:
        return np.zeros((3, 3))
    states = []
    for group in groups:
        left = np.where(np.isin(log.anchor, group), 0.0, log.trusted)
        without = replace(log, trusted=left)
        parts = [_smooth(without, each, _given(without, each.begin, each.end)).states for each in segments]
        states.append(np.concatenate(parts)[:, :3])
    off = np.array(states) - states[0]
    off[:, :, 2] = wrap_angle(off[:, :, 2])
    off -= off.mean(axis=0)
    covariance: Float = np.einsum("gti,gtj->ij", off, off) / off.shape[1] * (1 - 1 / len(groups))
    return covariance


def _bias_covariance(log: BodyLog, segments: list[BodySegment], bias_m2: Float) -> Float:
    """(3, 3) M^-1 S M^-1 for a mean round, in which each link ranges once: M = sum h h^T, S = sum P h h^T."""
    link = np.concatenate([log.link[log.rows(each.begin, each.end)] for each in segments])
    turned = np.concatenate([_directions(log, each)[1] for each in segments])
    rounds = len(link) / len(np.unique(link))
    information = turned.T @ turned / rounds + 1e-9 * np.eye(3)
    spread = (turned * bias_m2[link][:, None]).T @ turned / rounds
    inverse = np.linalg.inv(information)
    covariance: Float = inverse @ spread @ inverse
    return covariance
