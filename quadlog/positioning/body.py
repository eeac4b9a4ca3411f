"""Several tags on one rigid body: its place and its yaw from the ranges of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import interpolate_poses, seconds_since, turned, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.batch.causal import STAMP_STD_S, track_of
from quadlog.positioning.batch.factors import TagRanges
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.tracking import KNOT_S, Body, Starts
from quadlog.positioning.heading import UNKNOWN_YAW_STD_RAD, TagsYaw
from quadlog.positioning.locate import Anchors, TagInfo, TagResult, no_track, steadied, track_settings, with_track
from quadlog.positioning.odometry import BodyMotion, MeasuredMotion
from quadlog.positioning.settings import LocateSettings

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
class LocatedBody:
    """One track of a body from all of its tags.

    tags: of each tag, its fixes by itself, and the body's track at its place. middle_m: (2,) in base, the mean of the
    lever arms. track: of that point, at the mean of the tags' heights. yaw: of base; None where the lever arms do not
    show it. misplaced: tags that contradict their lever arms: these, where they are (2,), and how far apart.
    velocity: of the middle, by odometry.
    """

    tags: tuple[TagResult, ...]
    middle_m: Float
    track: Track
    yaw: TagsYaw | None
    misplaced: dict[int, tuple[Float, Float, float]]
    velocity: MeasuredMotion | None


def keep_distance(first: Track, second: Track) -> bool:
    """Whether two tags that move stay as far apart as two on one body."""
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
    """The track of a body that carries K located tags at levers_m (K, 2) in base; motion: its odometry.

    The pose of the tags' middle from every range of all tags with its tag's lever arm, and a bias for each link.
    Smoothed or causal as the tags are; it is carried away where the tag with the longest track is.
    """
    middle_m = levers_m.mean(axis=0)
    arms_m = levers_m - middle_m
    rows = [np.flatnonzero(np.isfinite(tag.ranges.predicted_m)) for tag in tags]
    row, number = np.concatenate(rows), np.repeat(np.arange(len(tags)), [len(each) for each in rows])
    t_ns, anchor, range_m = (
        np.concatenate([getattr(tag.ranges, name)[of_tag] for tag, of_tag in zip(tags, rows, strict=True)])
        for name in ("t_ns", "anchor", "range_m")
    )
    if len(t_ns) == 0:
        return LocatedBody(tuple(tags), middle_m, no_track(), None, {}, None)
    order = np.argsort(t_ns, kind="stable")
    t_ns, number, row, column = t_ns[order], number[order], row[order], anchors.columns_of(anchor[order])
    first_ns, range_m = int(t_ns[0]), range_m[order] - anchors.known_bias_m[column]
    heights_m, n_anchors = np.array([tag.height_m for tag in tags]), len(anchors.ids)
    ranges = TagRanges(seconds_since(t_ns, first_ns), number, column, range_m, arms_m, heights_m, n_anchors)
    how = track_settings(settings, all(tag.height_solved for tag in tags))
    cuts_s = seconds_since(max(tags, key=lambda tag: len(tag.track)).restart_ns, first_ns)
    seen = bool(np.hypot(*arms_m.T).max() > LEAST_LEVER_M)
    body, middle = Body(ranges, anchors.position_m, how, cuts_s, yaw=seen), TagInfo(-1, 0.0, motion, *middle_m.tolist())
    tracked, velocity = steadied(body, _starts(tags, arms_m, t_ns), t_ns, middle, smooth=settings.smooth)
    found, of_ranges = list(tags), tracked.of_ranges()
    for k in np.unique(number).tolist():
        found[k] = with_track(found[k], tracked, of_ranges, k, number == k, row[number == k])
    at_ns, first = np.unique(t_ns, return_index=True)
    track = track_of(tracked, ranges.t_s[first], at_ns, None)
    yaw, misplaced = None, dict[int, tuple[Float, Float, float]]()
    if (axis := body.axes.yaw) is not None:
        pose, rate, covariance = tracked.poses(ranges.t_s[first])
        misplaced = _misplaced(tags, levers_m, middle_m, pose[:, axis], track)
        constant_rad = min(LEVER_STD_M / float(np.sqrt((arms_m**2).sum())), UNKNOWN_YAW_STD_RAD)
        yaw_std = np.sqrt(covariance[:, axis, axis] + (STAMP_STD_S * rate[:, axis]) ** 2 + constant_rad**2)
        yaw = TagsYaw(wrap_angle(pose[:, axis]), np.minimum(yaw_std, UNKNOWN_YAW_STD_RAD), constant_rad)
    track = replace(track, covariance_m2=track.covariance_m2 + LEVER_STD_M**2 / len(arms_m) * np.eye(2))
    return LocatedBody(tuple(found), middle_m, track, yaw, misplaced, velocity)


def _starts(tags: Sequence[TagResult], arms_m: Float, t_ns: Int) -> Starts:
    """Rigid fits to the tags' own tracks, of which each goes on from its last pose before; seconds since the first."""
    known_ns = t_ns[np.unique((t_ns - t_ns[0]) // round(KNOT_S * 1e9), return_index=True)[1]]
    place_m, arm_m = np.full((len(tags), len(known_ns)), np.nan + 0j), (arms_m @ [1, 1j])[:, None]
    for own_m, track in zip(place_m, (tag.track for tag in tags), strict=True):
        if len(track) == 0:
            continue
        last = (np.searchsorted(track.t_ns, known_ns, side="right") - 1).clip(0)
        ahead_s = (known_ns - track.t_ns[last]) * 1e-9
        own_m[:] = (track.position_m[last] + ahead_s[:, None] * track.velocity_mps[last]) @ [1, 1j]
        own_m[(ahead_s < 0) | (ahead_s > START_NEAR_S)] = np.nan
    heard = np.isfinite(place_m)
    n = np.maximum(heard.sum(axis=0), 1)
    centre_m, arm_centre_m = np.nansum(place_m, axis=0) / n, (arm_m * heard).sum(axis=0) / n
    turn = np.nansum(np.conj(arm_m - arm_centre_m) * (place_m - centre_m), axis=0)
    seen, t_s, yaw_rad = heard.sum(axis=0) >= 2, seconds_since(known_ns, int(t_ns[0])), np.zeros(len(known_ns))
    if seen.any():
        yaw_rad = np.interp(t_s, t_s[seen], np.unwrap(np.angle(turn[seen])))
    origin_m = centre_m - np.exp(1j * yaw_rad) * arm_centre_m
    known = heard.any(axis=0)
    return Starts(t_s[known], np.column_stack([origin_m.real, origin_m.imag, yaw_rad])[known])


def _misplaced(
    tags: Sequence[TagResult], levers_m: Float, middle_m: Float, yaw_rad: Float, track: Track
) -> dict[int, tuple[Float, Float, float]]:
    """Tags whose own tracks lie elsewhere than their lever arms, if they do as a whole: one wrong arm moves all."""
    found, variance_m2 = dict[int, tuple[Float, Float, float]](), 0.0
    for tag, lever_m in zip(tags, levers_m, strict=True):
        _, at, own = np.intersect1d(track.t_ns, tag.track.t_ns, assume_unique=True, return_indices=True)
        if len(at):
            off_m = turned(-yaw_rad[at], tag.track.position_m[own] - track.position_m[at])
            found_m = np.median(off_m, axis=0) + middle_m
            found[tag.tag] = lever_m, found_m, float(np.hypot(*(found_m - lever_m)))
            variance_m2 += np.trace(tag.track.covariance_m2, axis1=1, axis2=2).mean()
    squares_m2 = [apart_m**2 for _, _, apart_m in found.values()]
    if sum(squares_m2) <= MISPLACED_STD**2 * variance_m2:
        return {}
    return {tag: each for tag, each in found.items() if each[2] ** 2 > np.mean(squares_m2) / 2}
