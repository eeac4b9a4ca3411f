"""Several tags on one rigid body solved together: one track, position and yaw from their lever arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import interpolate_poses, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.body.body_tracker import (
    BodyLog,
    BodySegment,
    filter_segment,
    innovations,
    log_body,
    predict_segment,
    segment_bounds,
    smooth_segment,
)
from quadlog.positioning.heading.heading import TagsYaw
from quadlog.positioning.heading.odometry_velocity import BodyMotion, MeasuredVelocity, measure_velocity
from quadlog.positioning.heading.yaw_offset import UNKNOWN_YAW_STD_RAD
from quadlog.positioning.locate import Anchors, LocateSettings, TagResult
from quadlog.positioning.track.range_log import VelocitySeries
from quadlog.positioning.track.segments import LOST_AFTER_S
from quadlog.positioning.track.tracker import LEAST_TRUST, STAMP_STD_S, Track

LEAST_LEVER_M = 0.01
"""Tags that are no farther than this from their middle show no yaw."""
LEVER_STD_M = 0.02
"""How well lever arms are known: a tape measure, and the phase centre of an antenna."""
START_NEAR_S = 1.0
MISPLACED_STD = 1.5
"""Lever arms are contradicted where tags lie, in rms, so many std of their own tracks from where these have them."""

LONGEST_BODY_M, LEAST_MOTION_M = 1.5, 0.5
STEADY_M, MOST_UNSTEADY_M = 0.1, 0.25
"""Half the spread of the distance between two tags of one body: the first, or, up to the second, what tracks claim."""


@dataclass(frozen=True, slots=True)
class MisplacedTag:
    """A tag whose own track has it at found_m (2,) in base, and the table at given_m (2,)."""

    tag: int
    given_m: Float
    found_m: Float

    @property
    def distance_m(self) -> float:
        """How far these are apart."""
        return float(np.hypot(*(self.found_m - self.given_m)))


@dataclass(frozen=True, slots=True)
class LocatedBody:
    """One track of a body from all of its tags.

    tags: of each tag, its fixes by itself, and the body's track at its place. middle_m: (2,) in base, the mean of the
    lever arms. track: of that point, at the mean of the tags' heights. yaw: of base; None where the lever arms do not
    show it. misplaced: tags that contradict their lever arms. velocity: of the middle, by odometry.
    """

    tags: tuple[TagResult, ...]
    middle_m: Float
    track: Track
    yaw: TagsYaw | None
    misplaced: tuple[MisplacedTag, ...]
    velocity: MeasuredVelocity | None


def keep_distance(first: Track, second: Track) -> bool:
    """Whether two tags that move stay as far apart as two on one body."""
    if min(len(first), len(second)) < 2:
        return False
    no_yaw = np.zeros(len(second))
    place_m, _, _ = interpolate_poses(first.t_ns, second.t_ns, second.position_m, no_yaw, START_NEAR_S)
    distance_m = np.hypot(*(first.position_m - place_m).T)
    known = np.isfinite(distance_m)
    if not known.any() or np.sqrt(first.position_m[known].var(axis=0).sum()) < LEAST_MOTION_M:
        return False
    low_m, middle_m, high_m = np.percentile(distance_m[known], [16, 50, 84])
    claimed_m2 = sum(np.trace(each.covariance_m2, axis1=1, axis2=2).mean() / 2 for each in (first, second))
    steady_m = np.clip(np.sqrt(claimed_m2), STEADY_M, MOST_UNSTEADY_M)
    return bool(middle_m < LONGEST_BODY_M and (high_m - low_m) / 2 < steady_m)


def locate_body(
    tags: Sequence[TagResult],
    levers_m: Float,
    anchors: Anchors,
    settings: LocateSettings,
    motion: BodyMotion | None = None,
) -> LocatedBody:
    """The track of a body that carries K located tags at levers_m (K, 2) in base.

    State: the tags' middle, its velocity, yaw and yaw rate, updated by every range at its own time with its tag's lever
    arm, the biases of the tags' own calibrations subtracted. Heights are those of the tags. Smoothed or causal as the
    tags are. motion: odometry of the body, whose velocity joins in as for a single tag.
    """
    middle_m = levers_m.mean(axis=0)
    arms_m = levers_m - middle_m
    rows = _gather_rows(tags, arms_m, anchors)
    log = _log(rows, settings, None)
    bounds = segment_bounds(log.instant_ns, _common_restarts(tags)) if len(log.instant_ns) else []
    starts = [_start(tags, arms_m, int(log.instant_ns[begin]), settings.smooth) for begin, _ in bounds]
    segments = _follow(log, bounds, starts, smooth=settings.smooth)
    constant = _spread(LEVER_STD_M**2, arms_m)
    lasting = constant + _spread(_lasting_variance(tags), arms_m)
    track = _track(log, segments, lasting, tags)
    velocity = None if motion is None else measure_velocity(motion, track, *middle_m, causal=not settings.smooth)
    if velocity is not None and velocity.series is not None:
        log = _log(rows, settings, velocity.series)
        segments = _follow(log, bounds, starts, smooth=settings.smooth)
        track = _track(log, segments, lasting, tags)
    states, covariances = _poses(segments, lasting)
    own = tuple(_tag_result(tag, k, arms_m[k], rows, log, segments, covariances) for k, tag in enumerate(tags))
    seen = bool(np.hypot(*arms_m.T).max() > LEAST_LEVER_M)
    return LocatedBody(
        tags=own,
        middle_m=middle_m,
        track=track,
        yaw=_yaw(states, covariances, float(np.sqrt(constant[2, 2]))) if seen else None,
        misplaced=_misplaced(tags, levers_m, middle_m, states, track) if seen else (),
        velocity=velocity,
    )


@dataclass(frozen=True, slots=True)
class _BodyRows:
    """The usable ranges of all tags in time order; tag: index into the tags; row: index into the tag's own ranges."""

    t_ns: Int
    tag: Int
    row: Int
    anchor_m: Float
    lever_m: Float
    range_m: Float
    trusted: Float


def _gather_rows(tags: Sequence[TagResult], arms_m: Float, anchors: Anchors) -> _BodyRows:
    """Without those before a tag's own track; weights are those of that track."""
    order = np.argsort(anchors.ids)
    parts: list[tuple[np.ndarray, ...]] = []
    for k, tag in enumerate(tags):
        row = np.flatnonzero(np.isfinite(tag.ranges.predicted_m))
        column = order[np.searchsorted(anchors.ids, tag.ranges.anchor[row], sorter=order)]
        anchor_m = anchors.position_m[column].copy()
        if len(tag.track):
            anchor_m[:, 2] = _height_at(tag.ranges.t_ns[row], tag.track) - anchor_m[:, 2]
        unbiased_m = tag.ranges.range_m[row] - (tag.bias_m + tag.shared_m)[column]
        number = np.full(len(row), k, dtype=np.int64)
        lever_m = np.broadcast_to(arms_m[k], (len(row), 2))
        weight = tag.ranges.weight[row]
        parts.append((tag.ranges.t_ns[row], number, row, anchor_m, lever_m, unbiased_m, weight))
    whole = [np.concatenate(each) for each in zip(*parts, strict=True)]
    in_time = np.argsort(whole[0], kind="stable")
    return _BodyRows(*(each[in_time] for each in whole))


def _height_at(t_ns: Int, track: Track) -> Float:
    """(N,) the track's height at instants (N,), held beyond its ends."""
    since_s, known_s = ((each - track.t_ns[0]) * 1e-9 for each in (t_ns, track.t_ns))
    return np.interp(since_s, known_s, track.z_m)


def _log(rows: _BodyRows, settings: LocateSettings, velocity: VelocitySeries | None) -> BodyLog:
    return log_body(
        rows.t_ns,
        rows.anchor_m,
        rows.lever_m,
        rows.range_m,
        rows.trusted if settings.smooth else np.ones(len(rows.t_ns)),
        range_std_m=settings.range_std_m,
        acceleration_std_mps2=settings.acceleration_std_mps2,
        velocity=velocity,
        causal=not settings.smooth,
    )


def _common_restarts(tags: Sequence[TagResult]) -> Int:
    """Where the body's track begins again: half or more of the tags' own tracks did within LOST_AFTER_S until then."""
    ns = np.sort(np.concatenate([tag.restart_ns for tag in tags]))
    heard = sum(len(tag.track) > 0 for tag in tags)
    since = np.arange(len(ns)) - np.searchsorted(ns, ns - round(LOST_AFTER_S * 1e9)) + 1
    ends = np.append(np.diff(ns) > LOST_AFTER_S * 1e9, True)[: len(ns)]
    restarts: Int = ns[(2 * since >= heard) & ends]
    return restarts


def _start(tags: Sequence[TagResult], arms_m: Float, at_ns: int, smooth: bool) -> Float:
    """(6,) the rigid fit to the tags' own tracks at an instant, at rest; a causal one to what was known then."""
    places: list[Float] = []
    arms: list[Float] = []
    for tag, arm_m in zip(tags, arms_m, strict=True):
        k = int(np.searchsorted(tag.track.t_ns, at_ns, side="left" if smooth else "right")) - (0 if smooth else 1)
        if 0 <= k < len(tag.track) and abs(int(tag.track.t_ns[k]) - at_ns) <= START_NEAR_S * 1e9:
            places.append(tag.track.position_m[k])
            arms.append(arm_m)
    place_m, arm_m = np.array(places).reshape(-1, 2), np.array(arms).reshape(-1, 2)
    if len(place_m) == 0:
        return np.zeros(6)
    off_m, off_arm = place_m - place_m.mean(axis=0), arm_m - arm_m.mean(axis=0)
    yaw = float(np.arctan2((off_arm[:, 0] * off_m[:, 1] - off_arm[:, 1] * off_m[:, 0]).sum(), (off_arm * off_m).sum()))
    x_m, y_m = place_m.mean(axis=0) - _turned(np.array([yaw]), arm_m.mean(axis=0))[0]
    return np.array([x_m, y_m, yaw, 0.0, 0.0, 0.0])


def _follow(log: BodyLog, bounds: list[tuple[int, int]], starts: list[Float], *, smooth: bool) -> list[BodySegment]:
    segments = [filter_segment(log, *each, start) for each, start in zip(bounds, starts, strict=True)]
    return [smooth_segment(log, each) for each in segments] if smooth else segments


def _lasting_variance(tags: Sequence[TagResult]) -> float:
    """Of each axis of one tag's place, in m^2, from errors that last: what the tags' own tracks have of it, their mean.

    That is by how much their covariances were raised, less what stamps do, which is added to a body as a whole.
    """
    found = [0.0]
    for tag in (tag.track for tag in tags if len(tag.track)):
        raised_m2 = np.trace(tag.covariance_m2, axis1=1, axis2=2) * (1 - 1 / tag.position_excess)
        found.append(float(np.mean(raised_m2 - STAMP_STD_S**2 * (tag.velocity_mps**2).sum(axis=1))))
    return max(sum(found) / max(len(found) - 1, 1), 0.0) / 2


def _spread(variance_m2: float, arms_m: Float) -> Float:
    """(3, 3) of x, y and yaw, where each tag's place is off by itself with a variance of each axis."""
    square_m2 = max(float((arms_m**2).sum()), 1e-9)
    covariance: Float = variance_m2 * np.diag([1 / len(arms_m), 1 / len(arms_m), 1 / square_m2])
    return covariance


def _poses(segments: list[BodySegment], lasting: Float) -> tuple[Float, Float]:
    """States (T, 6) and covariances (T, 3, 3) of x, y and yaw, with what lasts and what stamps are off by."""
    states = np.concatenate([np.empty((0, 6)), *(each.states for each in segments)])
    covariances = np.concatenate([np.empty((0, 3, 3)), *(each.covariances[:, :3, :3] for each in segments)])
    stamps = STAMP_STD_S**2 * (states[:, 3:, None] * states[:, None, 3:])
    return states, covariances + lasting + stamps


def _yaw(states: Float, covariances: Float, constant_std_rad: float) -> TagsYaw:
    """Its std is at most that of a direction of which nothing is known."""
    std_rad = np.minimum(np.sqrt(covariances[:, 2, 2]), UNKNOWN_YAW_STD_RAD)
    return TagsYaw(wrap_angle(states[:, 2]), std_rad, min(constant_std_rad, UNKNOWN_YAW_STD_RAD))


def _track(log: BodyLog, segments: list[BodySegment], lasting: Float, tags: Sequence[TagResult]) -> Track:
    """Of the middle of the tags; its height is the mean of those that the tags have by themselves."""
    states, raised = _poses(segments, lasting)
    own = np.concatenate([np.empty((0, 6, 6)), *(each.covariances for each in segments)])
    t_ns = np.concatenate([np.empty(0, np.int64), *(log.instant_ns[each.begin : each.end] for each in segments)])
    place_m2 = raised[:, :2, :2]
    heights_m = [_height_at(t_ns, tag.track) for tag in tags if len(tag.track)]
    return Track(
        t_ns=t_ns,
        position_m=states[:, :2].copy(),
        velocity_mps=states[:, 3:5].copy(),
        covariance_m2=place_m2,
        velocity_covariance_m2ps2=own[:, 3:5, 3:5].copy(),
        z_m=np.mean(heights_m, axis=0) if heights_m else np.zeros(len(t_ns)),
        z_std_m=np.zeros(len(t_ns)),
        position_excess=np.trace(place_m2, axis1=1, axis2=2) / np.trace(own[:, :2, :2], axis1=1, axis2=2),
    )


def _tag_result(
    tag: TagResult,
    number: int,
    arm_m: Float,
    rows: _BodyRows,
    log: BodyLog,
    segments: list[BodySegment],
    covariances: Float,
) -> TagResult:
    """The tag with the body's track at its place, at those instants at which it ranged."""
    mine = rows.tag == number
    predicted_m, weight = np.full(len(rows.t_ns), np.nan), np.zeros(len(rows.t_ns))
    n_ranges: list[Int] = [np.empty(0, np.int64)]
    nis: list[Float] = [np.empty(0)]
    for segment in segments:
        within = log.rows(segment.begin, segment.end)
        predicted_m[within], weight[within] = predict_segment(log, segment), segment.weight
        count, innovation = innovations(log, segment)
        n_ranges.append(count)
        nis.append(innovation)
    heard = np.unique(np.searchsorted(log.instant_ns, rows.t_ns[mine]))
    on_body = np.zeros(len(tag.ranges.t_ns)), np.full(len(tag.ranges.t_ns), np.nan)
    on_body[0][rows.row[mine]] = weight[mine]
    bias_m = tag.ranges.range_m[rows.row[mine]] - rows.range_m[mine]
    on_body[1][rows.row[mine]] = predicted_m[mine] + bias_m
    trust = max(float(weight.mean()), LEAST_TRUST) if len(weight) else 1.0
    states = np.concatenate([np.empty((0, 6)), *(each.states for each in segments)])[heard]
    return replace(
        tag,
        track=_track_at(tag.track, log.instant_ns[heard], states, covariances[heard], segments, heard, arm_m),
        ranges=replace(tag.ranges, weight=on_body[0], predicted_m=on_body[1]),
        n_untracked=int(np.isnan(on_body[1]).sum()),
        restart_ns=_common_restarts([tag]),
        n_ranges=np.concatenate(n_ranges)[heard],
        nis=np.concatenate(nis)[heard] / trust,
    )


def _track_at(
    own: Track, t_ns: Int, states: Float, covariances: Float, segments: list[BodySegment], heard: Int, arm_m: Float
) -> Track:
    """The body's track at a tag that sits arm_m from the middle: p + R a, whose change with yaw is R (-a_y, a_x)."""
    place_m, swing_m = _turned(states[:, 2], arm_m), _turned(states[:, 2], np.array([-arm_m[1], arm_m[0]]))
    change = np.concatenate([np.broadcast_to(np.eye(2), (len(t_ns), 2, 2)), swing_m[:, :, None]], axis=2)
    full = np.concatenate([np.empty((0, 6, 6)), *(each.covariances for each in segments)])[heard]
    before = np.searchsorted(own.t_ns, t_ns).clip(max=max(len(own) - 1, 0))
    return Track(
        t_ns=t_ns,
        position_m=states[:, :2] + place_m,
        velocity_mps=states[:, 3:5] + states[:, 5:] * swing_m,
        covariance_m2=change @ covariances @ change.transpose(0, 2, 1),
        velocity_covariance_m2ps2=full[:, 3:5, 3:5].copy(),
        z_m=own.z_m[before],
        z_std_m=own.z_std_m[before],
    )


def _misplaced(
    tags: Sequence[TagResult], levers_m: Float, middle_m: Float, states: Float, track: Track
) -> tuple[MisplacedTag, ...]:
    """Tags whose own tracks, seen from the body, lie elsewhere than their lever arms; none unless they do as a whole.

    The body's yaw follows lever arms that are wrong as far as it can, so one wrong arm moves all tags.
    """
    found, variances_m2 = [], []
    for tag, lever_m in zip(tags, levers_m, strict=True):
        at = np.searchsorted(track.t_ns, tag.track.t_ns)
        same = (at < len(track)) & (track.t_ns[at.clip(max=max(len(track) - 1, 0))] == tag.track.t_ns)
        if same.any():
            off_m = tag.track.position_m[same] - track.position_m[at[same]]
            seen_m = np.median(_turned(-states[at[same], 2], off_m), axis=0) + middle_m
            found.append(MisplacedTag(tag.tag, lever_m, seen_m))
            variances_m2.append(np.trace(tag.track.covariance_m2, axis1=1, axis2=2).mean())
    squares_m2 = [each.distance_m**2 for each in found]
    if sum(squares_m2) <= MISPLACED_STD**2 * sum(variances_m2):
        return ()
    return tuple(each for each in found if each.distance_m**2 > np.mean(squares_m2) / 2)


def _turned(yaw_rad: Float, vector_m: Float) -> Float:
    """(T, 2) a vector (2,), or (T, 2), turned by yaw (T,)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = vector_m.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
