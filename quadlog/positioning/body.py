"""Several tags on one rigid body: its place and its yaw from the ranges of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import interpolate_poses, seconds_since, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.batch.causal import Known, follow
from quadlog.positioning.batch.factors import TagRanges, turned
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.tracking import (
    KNOT_S,
    LONGEST_GAP_S,
    Body,
    Starts,
    Tracked,
    TrackSettings,
    track_body,
)
from quadlog.positioning.heading import UNKNOWN_YAW_STD_RAD, TagsYaw
from quadlog.positioning.locate import (
    HEIGHT_STD_M,
    Anchors,
    LocateSettings,
    TagInfo,
    TagResult,
    along,
    columns_of,
    no_track,
    with_motion,
)
from quadlog.positioning.odometry import BodyMotion, MeasuredMotion, measure_motion

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
    velocity: MeasuredMotion | None


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

    The pose of the tags' middle from every range of all tags with its tag's lever arm, and a bias for each link.
    Smoothed or causal as the tags are. motion: odometry of the body, as for a single tag.
    """
    middle_m = levers_m.mean(axis=0)
    arms_m = levers_m - middle_m
    seen = bool(np.hypot(*arms_m.T).max() > LEAST_LEVER_M)
    rows = _gather_rows(tags)
    if len(rows.t_ns) == 0:
        return LocatedBody(tuple(tags), middle_m, no_track(), None, (), None)
    body = _body(tags, rows, arms_m, anchors, settings)
    first_ns, smooth = int(rows.t_ns[0]), settings.smooth
    starts = _starts(tags, arms_m, rows, smooth=smooth)
    tracked: Tracked | Known = track_body(body, starts) if smooth else follow(body, starts)
    t_ns, first = np.unique(rows.t_ns, return_index=True)
    t_s = body.ranges.t_s[first]
    velocity, middle = None, TagInfo(-1, 0.0, motion, *middle_m.tolist())
    if motion is not None:
        velocity = measure_motion(motion, tracked.track(t_s, t_ns, None), *middle_m, causal=not smooth)
        if velocity.reason is None:
            tracked = with_motion(tracked, starts, velocity, middle, first_ns)
    pose, _, covariance = tracked.poses(t_s)
    track = tracked.track(t_s, t_ns, None)
    constant_m2 = LEVER_STD_M**2 / len(arms_m)
    constant_rad = min(LEVER_STD_M / float(np.sqrt(max((arms_m**2).sum(), 1e-9))), UNKNOWN_YAW_STD_RAD)
    yaw = None
    if seen:
        yaw_std = np.hypot(np.sqrt(covariance[:, body.axes.yaw, body.axes.yaw]), constant_rad)
        yaw_rad = wrap_angle(pose[:, body.axes.yaw])
        yaw = TagsYaw(yaw_rad, np.minimum(yaw_std, UNKNOWN_YAW_STD_RAD), constant_rad)
    found, of_ranges = list(tags), tracked.of_ranges()
    for k in np.unique(rows.tag).tolist():
        mine = rows.tag == k
        found[k] = replace(found[k], **along(tracked, of_ranges, k, mine, found[k].ranges, rows.row[mine])._asdict())
    return LocatedBody(
        tags=tuple(found),
        middle_m=middle_m,
        track=replace(track, covariance_m2=track.covariance_m2 + constant_m2 * np.eye(2)),
        yaw=yaw,
        misplaced=_misplaced(tags, levers_m, middle_m, yaw.yaw_rad, track) if yaw is not None else (),
        velocity=velocity,
    )


@dataclass(frozen=True, slots=True)
class _BodyRows:
    """The ranges of all tags on their tracks, in time order: tag: index into the tags; row: into the tag's ranges."""

    t_ns: Int
    tag: Int
    row: Int


def _gather_rows(tags: Sequence[TagResult]) -> _BodyRows:
    rows = [np.flatnonzero(np.isfinite(tag.ranges.predicted_m)) for tag in tags]
    t_ns = np.concatenate([tag.ranges.t_ns[row] for tag, row in zip(tags, rows, strict=True)])
    number = np.repeat(np.arange(len(tags)), [len(row) for row in rows])
    in_time = np.argsort(t_ns, kind="stable")
    return _BodyRows(t_ns[in_time], number[in_time], np.concatenate(rows)[in_time])


def _body(
    tags: Sequence[TagResult], rows: _BodyRows, arms_m: Float, anchors: Anchors, settings: LocateSettings
) -> Body:
    """The ranges less known biases. It is carried away where half or more of the tags were within LONGEST_GAP_S."""
    anchor, range_m = np.zeros_like(rows.tag), np.zeros(len(rows.tag))
    for k, tag in enumerate(tags):
        mine = rows.tag == k
        anchor[mine] = columns_of(anchors.ids, tag.ranges.anchor[rows.row[mine]])
        range_m[mine] = tag.ranges.range_m[rows.row[mine]] - anchors.known_bias_m[anchor[mine]]
    t_s = seconds_since(rows.t_ns, int(rows.t_ns[0]))
    height_m, n_anchors = np.array([tag.height_m for tag in tags]), len(anchors.ids)
    ranges = TagRanges(t_s, rows.tag, anchor, range_m, arms_m, height_m, n_anchors)
    height_std_m = HEIGHT_STD_M if all(tag.height_solved for tag in tags) else 0.0
    own = TrackSettings(settings.range_std_m, settings.acceleration_std_mps2, height_std_m, settings.calibrate)
    restarts_ns = np.sort(np.concatenate([tag.restart_ns for tag in tags]))
    since = np.arange(len(restarts_ns)) - np.searchsorted(restarts_ns, restarts_ns - round(LONGEST_GAP_S * 1e9)) + 1
    ends = np.append(np.diff(restarts_ns) > LONGEST_GAP_S * 1e9, True)[: len(restarts_ns)]
    heard = sum(len(tag.track) > 0 for tag in tags)
    cuts_s = seconds_since(restarts_ns[(2 * since >= heard) & ends], int(rows.t_ns[0]))
    return Body(ranges, anchors.position_m, own, cuts_s, yaw=bool(np.hypot(*arms_m.T).max() > LEAST_LEVER_M))


def _starts(tags: Sequence[TagResult], arms_m: Float, rows: _BodyRows, *, smooth: bool) -> Starts:
    """Rigid fits to the tags' own tracks; causal ones to what was known then."""
    known_ns = np.unique(rows.t_ns)
    known_ns = known_ns[np.unique((known_ns - known_ns[0]) // round(KNOT_S * 1e9), return_index=True)[1]]
    places_m = np.full((len(tags), len(known_ns), 2), np.nan)
    for place_m, track in zip(places_m, (tag.track for tag in tags), strict=True):
        if len(track) == 0:
            continue
        last = np.searchsorted(track.t_ns, known_ns, side="right") - 1
        k = (np.searchsorted(track.t_ns, known_ns) if smooth else last).clip(0, len(track) - 1)
        ahead_s = (known_ns - track.t_ns[k]) * 1e-9
        near = (np.abs(ahead_s) <= START_NEAR_S) & (smooth | (ahead_s >= 0))
        place_m[near] = track.position_m[k[near]] + ahead_s[near, None] * track.velocity_mps[k[near]]
    heard = np.isfinite(places_m[:, :, 0])
    n = np.maximum(heard.sum(axis=0), 1)
    centre_m, arm_m = np.nansum(places_m, axis=0) / n[:, None], heard.T @ arms_m / n[:, None]
    off_m, off_arm_m = np.nan_to_num(places_m - centre_m), (arms_m[:, None] - arm_m) * heard[:, :, None]
    sine = (off_arm_m[:, :, 0] * off_m[:, :, 1] - off_arm_m[:, :, 1] * off_m[:, :, 0]).sum(axis=0)
    seen = np.flatnonzero(heard.sum(axis=0) >= 2)
    t_s, yaw_rad = seconds_since(known_ns, int(rows.t_ns[0])), np.zeros(len(known_ns))
    if len(seen):
        yaw_rad = np.interp(t_s, t_s[seen], np.unwrap(np.arctan2(sine, (off_arm_m * off_m).sum(axis=(0, 2)))[seen]))
    pose = np.column_stack([centre_m - turned(yaw_rad, arm_m), yaw_rad])[heard.any(axis=0)]
    return Starts(t_s[heard.any(axis=0)], pose)


def _misplaced(
    tags: Sequence[TagResult], levers_m: Float, middle_m: Float, yaw_rad: Float, track: Track
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
            seen_m = np.median(turned(-yaw_rad[at[same]], off_m), axis=0) + middle_m
            found.append(MisplacedTag(tag.tag, lever_m, seen_m))
            variances_m2.append(np.trace(tag.track.covariance_m2, axis1=1, axis2=2).mean())
    squares_m2 = [each.distance_m**2 for each in found]
    if sum(squares_m2) <= MISPLACED_STD**2 * sum(variances_m2):
        return ()
    return tuple(each for each in found if each.distance_m**2 > np.mean(squares_m2) / 2)
