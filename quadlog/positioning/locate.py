"""Where every tag was: screen, group, fix, track with the links' biases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import interpolate_poses, seconds_since
from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.batch.causal import Known, follow, track_of
from quadlog.positioning.batch.factors import TagRanges
from quadlog.positioning.batch.links import AnchorBias, RangeRows
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.robust import USUAL_STD_M
from quadlog.positioning.batch.tracking import LONGEST_GAP_S, Body, Starts, Tracked, TrackSettings, track_body
from quadlog.positioning.epochs import Epochs, RangeCounts, group_epochs, screen_ranges
from quadlog.positioning.fixes import Fixes, are_on_line, heights_are_told, solve_fixes, solve_on_side
from quadlog.positioning.odometry import BodyMotion, MeasuredMotion, measure_motion
from quadlog.positioning.settings import LocateSettings

FEW_FIXES = 0.1
"""Share of good fixes below which ranges are tried for a scale."""
HEIGHT_STD_M = 0.5
"""Std of the given height of a tag whose height is tracked: what a person lifts or lowers it by."""


@dataclass(frozen=True, slots=True)
class Anchors:
    """A anchors in map: ids (A,), each once; position_m (A, 3); known_bias_m (A,), subtracted from every range."""

    ids: Int
    position_m: Float
    known_bias_m: Float

    def columns_of(self, ids: Int) -> Int:
        """(N,) indices of ids (N,), which are all among these."""
        order = np.argsort(self.ids)
        return order[np.searchsorted(self.ids, ids, sorter=order)]


@dataclass(frozen=True, slots=True)
class TagInfo:
    """A tag to locate, and its height in map; body_motion: odometry of what carries it, at x_m, y_m in base."""

    id: int
    height_m: float
    body_motion: BodyMotion | None = None
    x_m: float = 0.0
    y_m: float = 0.0


def usual_std_m(settings: LocateSettings) -> float:
    """Of a range, before a track has shown more."""
    return settings.range_std_m or USUAL_STD_M


def track_settings(settings: LocateSettings, height_solved: bool) -> TrackSettings:
    """What a track is estimated with."""
    height_std_m = HEIGHT_STD_M if height_solved else 0.0
    return TrackSettings(settings.range_std_m, settings.acceleration_std_mps2, height_std_m, settings.calibrate)


@dataclass(frozen=True, slots=True)
class TagResult:
    """All that is known of one tag. Fixes are calibrated, not smoothed, one row per epoch at epochs.t_ns (E,).

    epoch_s: as given or derived; height_m: as given; height_solved: whether fixes and track solve for it instead.
    epochs: the ranges the fixes are made from, as measured. bias: what is subtracted beside the known biases, None
    unless calibrated; shared_m: the bias of all links that the track alone does without, where it is not. restart_ns:
    (R,) where the tag was carried away and its track begins again. n_ranges, nis: (T,) of each of the track's instants,
    its ranges and what they miss the track by, squared, over the variance that they have where range_std_m and the
    motion are right, by weights over their mean. range_std_m: (A,) of ranges in sight of each link. velocity: by
    odometry, None without.
    """

    tag: int
    height_m: float
    epoch_s: float
    height_solved: bool
    epochs: Epochs
    fixes: Fixes
    ranges: RangeRows
    track: Track
    restart_ns: Int
    n_ranges: Int
    nis: Float
    range_std_m: Float
    bias: AnchorBias | None = None
    shared_m: float = 0.0
    velocity: MeasuredMotion | None = None

    def without_scale(self, range_m: Float) -> Float:
        """Ranges divided by their scale, as estimated."""
        return range_m if self.bias is None else range_m / (1 + self.bias.scale)


@dataclass(frozen=True, slots=True)
class Located:
    """One result per tag, in the order asked for, the counts of all ranges, and whether the anchors lie on a line."""

    tags: tuple[TagResult, ...]
    counts: RangeCounts
    on_line: bool


def locate(ranges: RangeSeries, anchors: Anchors, tags: Sequence[TagInfo], settings: LocateSettings) -> Located:
    """Fixes and tracks of each tag by itself, from all ranges of a log.

    Raises MissingInput for fewer than three anchors, QuadlogError where all lie on one line and no side of it was
    asked for, UnknownName for a method that is none, TooLarge for a log beyond what is allocated.
    """
    refuse = settings.mirror == "refuse"
    on_line = are_on_line(anchors.ids, anchors.position_m, usual_std_m(settings), refuse=refuse)
    tag_ids = np.array([tag.id for tag in tags], dtype=np.int64)
    usable, counts = screen_ranges(ranges, tag_ids, anchors.ids, settings.min_range_m, settings.max_range_m)
    return Located(tuple(_locate(usable, anchors, tag, settings, on_line) for tag in tags), counts, on_line)


def _locate(
    ranges: RangeSeries,
    anchors: Anchors,
    tag: TagInfo,
    settings: LocateSettings,
    on_line: bool,
    *,
    may_scale: bool = True,
) -> TagResult:
    """Fixes to start from, the track, then fixes with its biases.

    Where nearly all fixes are outliers, the track starts from them, and counts if the ranges turn out to have a scale.
    """
    epochs, epoch_s = group_epochs(ranges, tag.id, anchors.ids, settings.epoch_s)
    known_m: Float = epochs.range_m - anchors.known_bias_m
    first = settings.model_copy(update={"method": "gauss_newton"})
    start = _fix(first, anchors, known_m, tag.height_m, settings.mirror, on_line)
    height_solved = settings.height == "solved" and not on_line
    if settings.height == "auto" and not on_line:
        height_solved = heights_are_told(anchors.position_m, start, usual_std_m(settings))
    mine, none = ranges.rows(ranges.tag == tag.id), np.empty(0, np.int64)
    rows = RangeRows(mine.t_ns, mine.anchor, mine.range_m, np.full(len(mine), np.nan), np.zeros(len(mine)))
    of_tag, unknown_m = (tag.id, tag.height_m, epoch_s, height_solved), np.full(len(anchors.ids), usual_std_m(settings))
    result = TagResult(*of_tag, epochs, start, rows, no_track(), none, none, np.empty(0), unknown_m)

    fixed, fix_ns = start.solved & ~start.outlier, epochs.t_ns if settings.smooth else epochs.last_ns
    rescued = may_scale and settings.smooth and not on_line and fixed.sum() < FEW_FIXES * start.solved.sum()
    fixed = start.solved if rescued else fixed
    row = np.flatnonzero(_in_segments_with_a_fix(mine.t_ns, fix_ns[fixed]))
    if len(row):
        first_ns, column = int(mine.t_ns[0]), anchors.columns_of(mine.anchor)
        range_m, t_s = mine.range_m - anchors.known_bias_m[column], seconds_since(mine.t_ns, first_ns)
        place = np.zeros((1, 2)), np.array([tag.height_m])
        heard = TagRanges(t_s, 0 * column, column, range_m, *place, len(anchors.ids))
        body = Body(heard.rows(row), anchors.position_m, track_settings(settings, height_solved), np.empty(0))
        starts = Starts(seconds_since(fix_ns[fixed], first_ns), start.position_m[fixed])
        if on_line and settings.smooth:
            # Its fixes are all on one side of the line, which a track that goes on as it did may cross.
            known = follow(body, starts)
            starts = Starts(known.t_s, known.state[:, :2])
        tracked, velocity = steadied(body, starts, mine.t_ns[row], tag, smooth=settings.smooth)
        if rescued and tracked.scale()[0] == 0:
            return _locate(ranges, anchors, tag, settings, on_line, may_scale=False)
        of_ranges, row = tracked.of_ranges(), row[tracked.known]
        result = replace(with_track(result, tracked, of_ranges, 0, tracked.known, row), velocity=velocity)
        bias_m, std_m = tracked.biases()
        if settings.calibrate:
            n = np.bincount(column, minlength=len(bias_m))
            bias = AnchorBias(bias_m, std_m, n, tracked.last.shares, *tracked.scale())
            known_m = tracked.corrected(seconds_since(epochs.last_ns, first_ns), known_m)
            result = replace(result, bias=bias)
        else:
            result = replace(result, shared_m=float(bias_m.mean()))
    zero, track = np.zeros(len(result.track)), result.track
    side, _, _ = interpolate_poses(epochs.t_ns, track.t_ns, track.position_m, zero, epoch_s)
    fixes = _fix(settings, anchors, known_m, None if height_solved else tag.height_m, side, on_line)
    return replace(result, fixes=fixes)


def _fix(
    settings: LocateSettings, anchors: Anchors, range_m: Float, height_m: float | None, side: str | Float, on_line: bool
) -> Fixes:
    """Fixes of epochs (E, A), of anchors on a line on the side of places (E, 2), or the side that is asked for."""
    if on_line and height_m is not None:
        return solve_on_side(anchors.position_m, range_m, height_m, usual_std_m(settings), settings.outlier_m, side)
    seen = anchors.position_m, range_m, height_m, usual_std_m(settings)
    return solve_fixes(settings.method, *seen, settings.outlier_m)


def steadied(
    body: Body, starts: Starts, t_ns: Int, tag: TagInfo, *, smooth: bool
) -> tuple[Tracked | Known, MeasuredMotion | None]:
    """The track of a body from its ranges at t_ns (R,), and again with the odometry of what carries the tag, if any."""
    tracked = track_body(body, starts, final=tag.body_motion is None) if smooth else follow(body, starts)
    if tag.body_motion is None:
        return tracked, None
    first_ns = int(t_ns[0]) - round(body.ranges.t_s[0] * 1e9)
    at_ns, first = np.unique(t_ns[tracked.known], return_index=True)
    alone = track_of(tracked, body.ranges.t_s[tracked.known][first], at_ns, None)
    motion = measure_motion(tag.body_motion, alone, (tag.x_m, tag.y_m), first_ns, causal=not smooth)
    if motion.odometry is None:
        return tracked, motion
    body = replace(tracked.body, motion=motion.odometry)
    if smooth:
        t_s = tracked.body.timeline.t_s
        yaw_rad = np.interp(t_s, motion.odometry.way.t_s, motion.yaw_rad)
        body, starts = replace(body, yaw=True), Starts(t_s, np.column_stack([tracked.last.knots[:, 0, :2], yaw_rad]))
    return track_body(body, starts) if smooth else follow(body, starts), motion


def with_track(
    result: TagResult, tracked: Tracked | Known, of_ranges: Sequence[Float], number: int, mine: np.ndarray, row: Int
) -> TagResult:
    """With what a track says of one of its tags, by those of its ranges that are `mine`, `row` of the tag's."""
    rows = result.ranges
    predicted_m, weight = np.full(len(rows.t_ns), np.nan), np.zeros(len(rows.t_ns))
    residual_m, weight[row], square = (each[mine] for each in of_ranges)
    predicted_m[row] = rows.range_m[row] - residual_m
    t_ns, first, n_ranges = np.unique(rows.t_ns[row], return_index=True, return_counts=True)
    t_s = tracked.body.ranges.t_s[mine][first]
    return replace(
        result,
        ranges=replace(rows, predicted_m=predicted_m, weight=weight),
        track=track_of(tracked, t_s, t_ns, number),
        restart_ns=t_ns[np.searchsorted(t_s, tracked.restarts_s - 1e-9).clip(max=len(t_ns) - 1)],
        n_ranges=n_ranges,
        nis=np.add.reduceat(square, first) / n_ranges,
        range_std_m=np.split(tracked.last.weights.std_m, len(tracked.body.ranges.lever_m))[number],
    )


def _in_segments_with_a_fix(t_ns: Int, fix_ns: Int) -> np.ndarray:
    """(R,) bool, of ranges at t_ns (R,) those between whose gaps of LONGEST_GAP_S there is a fix."""
    segment = np.append(0, np.cumsum(np.diff(t_ns) > LONGEST_GAP_S * 1e9))[: len(t_ns)]
    return np.isin(segment, segment[(np.searchsorted(t_ns, fix_ns, side="right") - 1).clip(0)])


def no_track() -> Track:
    """Of a tag that was never located."""
    none = np.empty((0, 2, 2))
    return Track(np.empty(0, np.int64), none[:, 0], none[:, 0], none, none, np.empty(0), np.empty(0))
