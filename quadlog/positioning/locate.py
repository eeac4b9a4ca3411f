"""Where every tag was: screen, group, fix, track with the links' biases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from quadlog.geometry import interpolate_poses
from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.batch.causal import Known, follow
from quadlog.positioning.batch.factors import TagRanges
from quadlog.positioning.batch.links import AnchorBias, RangeRows
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.tracking import (
    LONGEST_GAP_S,
    Body,
    Starts,
    Tracked,
    TrackSettings,
    track_body,
)
from quadlog.positioning.epochs import Epochs, RangeCounts, group_epochs, screen_ranges
from quadlog.positioning.fixes import Fixes, Side, are_on_line, heights_are_told, solve_fixes, solve_on_side
from quadlog.positioning.odometry import (
    BodyMotion,
    MeasuredMotion,
    measure_motion,
    odometry_in_map,
    tag_odometry,
)

HEIGHT_STD_M = 0.5
"""Std of the given height of a tag whose height is tracked: what a person lifts or lowers it by."""


@dataclass(frozen=True, slots=True)
class Anchors:
    """A anchors in map: ids (A,), each once; position_m (A, 3); known_bias_m (A,), subtracted from every range."""

    ids: Int
    position_m: Float
    known_bias_m: Float


@dataclass(frozen=True, slots=True)
class TagInfo:
    """A tag to locate, and its height in map; body_motion: odometry of what carries it, at x_m, y_m in base."""

    id: int
    height_m: float
    body_motion: BodyMotion | None = None
    x_m: float = 0.0
    y_m: float = 0.0


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """How ranges become positions.

    method, height, mirror: as the configuration's section `uwb` explains them.
    epoch_s: single ranges this close together make one fix; None: derived from the log, tag by tag.
    calibrate: estimate a constant bias of each link and subtract it; without, one that all links share.
    smooth: estimate tracks from the whole log; False: every pose, bias and covariance as it was known at its instant.
    """

    range_std_m: float = 0.1
    min_range_m: float = 0.05
    max_range_m: float = 300.0
    epoch_s: float | None = None
    outlier_m: float = 0.5
    acceleration_std_mps2: float = 1.0
    method: str = "gauss_newton"
    height: Literal["auto", "given", "solved"] = "auto"
    mirror: Literal["refuse", "left", "right"] = "refuse"
    calibrate: bool = True
    smooth: bool = True


@dataclass(frozen=True, slots=True)
class TagResult:
    """All that is known of one tag. Fixes are calibrated, not smoothed, one row per epoch at fix_t_ns (E,).

    epoch_s: as given or derived; height_m: as given; height_solved: whether fixes and track solve for it instead.
    bias_m: (A,) what was subtracted from the ranges, known and estimated; bias: the estimate, None unless calibrated.
    shared_m: the bias of all links that the track alone does without, where they are not calibrated.
    n_too_few, n_degenerate: epochs without a fix.
    restart_ns: (R,) where the tag was carried away and its track begins again.
    n_ranges, nis: (T,) of each of the track's instants, its ranges and what they miss the track by, squared, over the
    variance that they have where range_std_m and the motion are right, by their weights over the mean weight.
    epochs: the ranges the fixes are made from, as measured. velocity: what odometry has of the tag's motion, None where
    there is none.
    """

    tag: int
    height_m: float
    epoch_s: float
    height_solved: bool
    fix_t_ns: Int
    fixes: Fixes
    ranges: RangeRows
    track: Track
    bias: AnchorBias | None
    bias_m: Float
    shared_m: float
    n_too_few: int
    n_degenerate: int
    restart_ns: Int
    n_ranges: Int
    nis: Float
    epochs: Epochs
    velocity: MeasuredMotion | None

    @property
    def n_untracked(self) -> int:
        """Ranges off the track."""
        return int(np.isnan(self.ranges.predicted_m).sum())


@dataclass(frozen=True, slots=True)
class Located:
    """One result per tag, in the order asked for, the counts of all ranges, and whether the anchors lie on a line."""

    tags: tuple[TagResult, ...]
    counts: RangeCounts
    on_line: bool


def locate(ranges: RangeSeries, anchors: Anchors, tags: Sequence[TagInfo], settings: LocateSettings) -> Located:
    """Fixes and tracks of each tag by itself, from all ranges of a log.

    Raises MissingInput for fewer than three anchors, AnchorsCollinear where all lie on one line and no side of it was
    asked for, UnknownName for a method that is none, TooLarge for a log beyond what is allocated.
    """
    refuse = settings.mirror == "refuse"
    on_line = are_on_line(anchors.ids, anchors.position_m, settings.range_std_m, refuse=refuse)
    tag_ids = np.array([tag.id for tag in tags], dtype=np.int64)
    usable, counts = screen_ranges(ranges, tag_ids, anchors.ids, settings.min_range_m, settings.max_range_m)
    return Located(tuple(_Tag(usable, anchors, tag, settings, on_line).located() for tag in tags), counts, on_line)


def columns_of(ids: Int, wanted: Int) -> Int:
    """(N,) indices into ids (A,) of ids (N,), which are all among them."""
    order = np.argsort(ids)
    columns: Int = order[np.searchsorted(ids, wanted, sorter=order)]
    return columns


class _Tag:
    """A tag that is being located: its usable ranges, epochs, and the fixes that its track starts from."""

    def __init__(
        self, ranges: RangeSeries, anchors: Anchors, tag: TagInfo, settings: LocateSettings, on_line: bool
    ) -> None:
        self.anchors, self.tag, self.settings, self.on_line = anchors, tag, settings, on_line
        mine = ranges.tag == tag.id
        self.t_ns, self.anchor, self.range_m = ranges.t_ns[mine], ranges.anchor[mine], ranges.range_m[mine]
        self.column = columns_of(anchors.ids, self.anchor)
        self.epochs, self.epoch_s = group_epochs(ranges, tag.id, anchors.ids, settings.epoch_s)
        self.start = self.fix("gauss_newton", anchors.known_bias_m, tag.height_m, None)
        self.height_solved = not on_line and self._solves_height()

    def fix(self, method: str, bias_m: Float, height_m: float | None, near: Track | None) -> Fixes:
        """Fixes of the epochs less biases (A,) or (E, A), of anchors on a line on the side of a track or its start."""
        settings, range_m = self.settings, self.epochs.range_m - bias_m
        if not self.on_line:
            return solve_fixes(
                method, self.anchors.position_m, range_m, height_m, settings.range_std_m, settings.outlier_m
            )
        assert settings.mirror != "refuse"
        start: Side | Float = settings.mirror
        if near is not None:
            zero = np.zeros(len(near))
            start, _, _ = interpolate_poses(self.epochs.t_ns, near.t_ns, near.position_m, zero, self.epoch_s)
        seen = self.anchors.position_m, range_m, self.tag.height_m, settings.range_std_m
        return solve_on_side(*seen, settings.outlier_m, start)

    def _solves_height(self) -> bool:
        """Whether the height is solved for: where asked, or where the ranges of the whole log show it."""
        if self.settings.height != "auto":
            return self.settings.height == "solved"
        range_m = self.epochs.range_m - self.anchors.known_bias_m
        return heights_are_told(self.anchors.position_m, range_m, self.settings.range_std_m)

    def located(self) -> TagResult:
        """Track, then fixes with its biases."""
        known_ns = self.epochs.t_ns if self.settings.smooth else self.epochs.last_ns
        usable = self.start.solved & ~self.start.outlier
        since_ns = known_ns[usable] - (0 if self.settings.smooth else round(self.epoch_s * 1e9))
        on_track = _in_segments_with_a_fix(self.t_ns, known_ns[usable], since_ns, causal=not self.settings.smooth)
        if not on_track.any():
            return self._result(None, on_track, None)
        first_ns = int(self.t_ns[0])
        column, range_m = self.column[on_track], (self.range_m - self.anchors.known_bias_m[self.column])[on_track]
        t_s = (self.t_ns[on_track] - first_ns) * 1e-9
        lever_m, height_m = np.zeros((1, 2)), np.array([self.tag.height_m])
        ranges = TagRanges(t_s, np.zeros_like(column), column, range_m, lever_m, height_m, len(self.anchors.ids))
        starts = Starts((known_ns[usable] - first_ns) * 1e-9, self.start.position_m[usable, :2])
        body = Body(ranges, self.anchors.position_m, self._track_settings(), np.empty(0))
        if self.on_line and self.settings.smooth:
            # Its fixes are all on one side of the line, which a track that goes on as it did may cross.
            known = follow(body, starts)
            starts = Starts(known.t_s, known.state[:, :2])
        tracked = track_body(body, starts) if self.settings.smooth else follow(body, starts)
        if self.tag.body_motion is None:
            return self._result(tracked, on_track, None)
        t_ns, first = np.unique(self.t_ns[on_track][tracked.known], return_index=True)
        alone = tracked.track(t_s[tracked.known][first], t_ns, 0)
        place = self.tag.x_m, self.tag.y_m
        motion = measure_motion(self.tag.body_motion, alone, *place, causal=not self.settings.smooth)
        if motion.reason is None:
            tracked = with_motion(tracked, starts, motion, self.tag, first_ns)
        return self._result(tracked, on_track, motion)

    def _track_settings(self) -> TrackSettings:
        """As this tag is tracked."""
        settings = self.settings
        height_std_m = HEIGHT_STD_M if self.height_solved else 0.0
        return TrackSettings(settings.range_std_m, settings.acceleration_std_mps2, height_std_m, settings.calibrate)

    def _result(
        self, tracked: Tracked | Known | None, on_track: np.ndarray, velocity: MeasuredMotion | None
    ) -> TagResult:
        bias_m, known_bias_m, shared_m, bias = self.anchors.known_bias_m, self.anchors.known_bias_m, 0.0, None
        unknown, none = np.full(len(self.t_ns), np.nan), np.empty(0, np.int64)
        rows, track = RangeRows(self.t_ns, self.anchor, self.range_m, unknown, 0 * self.range_m), no_track()
        about = _OnTrack(track, rows, none, none, np.empty(0))
        subtracted_m = bias_m
        if tracked is not None:
            row = np.flatnonzero(on_track)[tracked.known]
            about = along(tracked, tracked.of_ranges(), 0, tracked.known, rows, row)
            own_m, std_m = tracked.biases()
            if self.settings.calibrate:
                heard = np.bincount(self.column, minlength=len(bias_m))
                bias = AnchorBias(own_m, std_m, heard, tracked.last.shares)
                subtracted_m = bias_m = known_bias_m + bias.applied_m
                if isinstance(tracked, Known):
                    known_s = (self.epochs.last_ns - int(self.t_ns[0])) * 1e-9
                    subtracted_m = known_bias_m + tracked.biases_at(known_s)
            else:
                shared_m = float(own_m.mean())
        fixes_height_m = None if self.height_solved else self.tag.height_m
        fixes = self.fix(self.settings.method, subtracted_m, fixes_height_m, about.track)
        return TagResult(
            tag=self.tag.id,
            height_m=self.tag.height_m,
            epoch_s=self.epoch_s,
            height_solved=self.height_solved,
            fix_t_ns=self.epochs.t_ns,
            fixes=fixes,
            bias=bias,
            bias_m=bias_m,
            shared_m=shared_m,
            n_too_few=int((fixes.n_ranges < (4 if self.height_solved else 3)).sum()),
            n_degenerate=int(fixes.degenerate.sum()),
            epochs=self.epochs,
            velocity=velocity,
            **about._asdict(),
        )


class _OnTrack(NamedTuple):
    """What a track says of a tag: fields of TagResult."""

    track: Track
    ranges: RangeRows
    restart_ns: Int
    n_ranges: Int
    nis: Float


def along(
    tracked: Tracked | Known, of_ranges: Sequence[Float], number: int, mine: np.ndarray, rows: RangeRows, row: Int
) -> _OnTrack:
    """What a track says of one of its tags, by those of its ranges that are `mine`, which are `row` of the tag's."""
    predicted_m, weight = np.full(len(rows.t_ns), np.nan), np.zeros(len(rows.t_ns))
    residual_m, weight[row], square = (each[mine] for each in of_ranges)
    predicted_m[row] = rows.range_m[row] - residual_m
    t_ns, first, n_ranges = np.unique(rows.t_ns[row], return_index=True, return_counts=True)
    t_s = tracked.body.ranges.t_s[mine][first]
    at = np.searchsorted(t_s, tracked.restarts_s - 1e-9).clip(max=len(t_ns) - 1)
    ranges = replace(rows, predicted_m=predicted_m, weight=weight)
    return _OnTrack(
        tracked.track(t_s, t_ns, number), ranges, t_ns[at], n_ranges, np.add.reduceat(square, first) / n_ranges
    )


def with_motion(
    tracked: Tracked | Known, starts: Starts, motion: MeasuredMotion, tag: TagInfo, first_ns: int
) -> Tracked | Known:
    """The track of a tag again, with the odometry of what carries it."""
    assert tag.body_motion is not None
    if isinstance(tracked, Known):
        return follow(replace(tracked.body, motion=odometry_in_map(motion, first_ns)), starts)
    odometry = tag_odometry(tag.body_motion, motion, first_ns, tag.x_m, tag.y_m)
    t_s, pose = tracked.body.timeline.t_s, tracked.last.knots[:, 0]
    at_knots = Starts(t_s, np.column_stack([pose[:, :2], np.interp(t_s, odometry.way.t_s, motion.yaw_rad)]))
    return track_body(replace(tracked.body, yaw=True, motion=odometry), at_knots)


def _in_segments_with_a_fix(t_ns: Int, fix_ns: Int, since_ns: Int, *, causal: bool) -> np.ndarray:
    """(R,) bool, of ranges at t_ns (R,) those between whose gaps of LONGEST_GAP_S there is a fix; causal: from since_ns
    of the first fix on.
    """
    segment = np.append(0, np.cumsum(np.diff(t_ns) > LONGEST_GAP_S * 1e9))[: len(t_ns)]
    of_fix = segment[(np.searchsorted(t_ns, fix_ns, side="right") - 1).clip(0)]
    found, first = np.unique(of_fix, return_index=True)
    kept = np.isin(segment, found)
    if causal and len(found):
        kept &= t_ns >= since_ns[first][np.searchsorted(found, segment).clip(max=len(found) - 1)]
    return kept


def no_track() -> Track:
    """Of a tag that was never located."""
    none = np.empty((0, 2, 2))
    return Track(np.empty(0, np.int64), none[:, 0], none[:, 0], none, none, np.empty(0), np.empty(0))
