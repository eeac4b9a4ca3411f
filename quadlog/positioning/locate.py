"""Where every tag was: screen, group, calibrate, fix, track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from quadlog.errors import AnchorsCollinear
from quadlog.geometry import interpolate_poses
from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.anchor_bias import AnchorBias, Calibration, calibrate_links
from quadlog.positioning.epochs import Epochs, RangeCounts, derive_epoch_s, group_epochs, screen_ranges
from quadlog.positioning.fix.ambiguity import heights_are_told, solve_on_side, start_on_side
from quadlog.positioning.fix.least_squares import Fixes, require_spread
from quadlog.positioning.fix.trilateration import solve_fixes
from quadlog.positioning.heading.odometry_velocity import BodyMotion, MeasuredVelocity, measure_velocity
from quadlog.positioning.track.range_log import VelocitySeries
from quadlog.positioning.track.tracker import Track, TrackedRanges, track_ranges

HEIGHT_STD_M = 0.5
"""How far the given height of a tag whose height is tracked may be off: what a person lifts or lowers it by."""


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
    calibrate: estimate each link's constant bias and subtract it where that makes positions agree better.
    smooth: tracks smoothed over the whole log. False makes every pose of the track causal given the biases; biases and
    the scale of the covariances still come from the whole log.
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
class RangeRows:
    """The N usable ranges of one tag.

    range_m: as measured; predicted_m: from the track, bias included, NaN off the track.
    weight: robust weight in the track, one for full trust, near zero for NLOS, zero off the track.
    """

    t_ns: Int
    anchor: Int
    range_m: Float
    predicted_m: Float
    weight: Float


@dataclass(frozen=True, slots=True)
class TagResult:
    """All that is known of one tag. Fixes are calibrated, not smoothed, one row per epoch at fix_t_ns (E,).

    epoch_s: as given or derived; height_m: as given; height_solved: whether fixes and track solve for it instead.
    bias_m: (A,) what was subtracted from the ranges, known and estimated; bias: the estimate, None unless calibrated.
    shared_m: beyond that, what all links have in common, which the smoothed track alone does without.
    n_too_few, n_degenerate: epochs without a fix; n_untracked: ranges off the track.
    restart_ns, n_ranges, nis: of the track, as in TrackedRanges; epochs: the ranges the fixes are made from, as
    measured.
    velocity: what odometry told of the tag's motion, None where there is none.
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
    n_untracked: int
    restart_ns: Int
    n_ranges: Int
    nis: Float
    epochs: Epochs
    velocity: MeasuredVelocity | None


@dataclass(frozen=True, slots=True)
class Located:
    """One result per tag, in the order asked for, the counts of all ranges, and whether the anchors lie on a line."""

    tags: tuple[TagResult, ...]
    counts: RangeCounts
    on_line: bool

    @property
    def why_no_bias(self) -> str:
        """Why tags without an estimate of biases have none."""
        return "biases are not estimated with anchors on a line" if self.on_line else "calibration is off"


def locate(ranges: RangeSeries, anchors: Anchors, tags: Sequence[TagInfo], settings: LocateSettings) -> Located:
    """Fixes and tracks of each tag by itself, from all ranges of a log.

    Raises MissingInput for fewer than three anchors, AnchorsCollinear where all lie on one line and no side of it was
    asked for, UnknownName for a method that is none, TooLarge for a log beyond what is allocated.
    """
    on_line = _are_on_line(anchors, settings)
    tag_ids = np.array([tag.id for tag in tags], dtype=np.int64)
    usable, counts = screen_ranges(ranges, tag_ids, anchors.ids, settings.min_range_m, settings.max_range_m)
    step = _locate_on_side if on_line else _locate_tag
    return Located(tuple(step(usable, anchors, tag, settings) for tag in tags), counts, on_line)


def _are_on_line(anchors: Anchors, settings: LocateSettings) -> bool:
    """Whether all anchors lie on a line, which leaves two mirrored places, and one of them was asked for."""
    try:
        require_spread(anchors.ids, anchors.position_m, settings.range_std_m)
    except AnchorsCollinear:
        if settings.mirror == "refuse":
            raise
        return True
    return False


def _locate_tag(ranges: RangeSeries, anchors: Anchors, tag: TagInfo, settings: LocateSettings) -> TagResult:
    epoch_s, epochs = _epochs(ranges, anchors, tag, settings)
    known_m = epochs.range_m - anchors.known_bias_m
    flat = _fix("gauss_newton", known_m, anchors, tag.height_m, settings)
    solved = _solves_height(known_m, anchors, tag, settings, flat)
    rows = _rows(ranges, anchors, tag)
    height_std_m = HEIGHT_STD_M if solved else 0.0
    known = _Known(rows, anchors, tag, settings, height_std_m, anchors.known_bias_m, None)
    known = known.calibrated(epochs, flat)
    fixes = _fix(settings.method, epochs.range_m - known.bias_m, anchors, None if solved else tag.height_m, settings)
    tracked = known.track(epochs, fixes)
    velocity = _measure_velocity(tag, tracked, settings)
    if velocity is not None and velocity.series is not None:
        tracked = known.track(epochs, fixes, velocity.series)
    return _result(known, epoch_s, epochs, fixes, tracked, velocity)


def _solves_height(range_m: Float, anchors: Anchors, tag: TagInfo, settings: LocateSettings, flat: Fixes) -> bool:
    """Whether the height is solved for, with the ranges (E, A) of a whole log: where asked, or where they tell it.

    flat: the fixes at the given height.
    """
    if settings.height != "auto":
        return settings.height == "solved"
    heard = np.isfinite(range_m)
    return heights_are_told(anchors.position_m, flat.position_m, tag.height_m, heard, settings.range_std_m)


def _fix(method: str, range_m: Float, anchors: Anchors, height_m: float | None, settings: LocateSettings) -> Fixes:
    return solve_fixes(method, anchors.position_m, range_m, height_m, settings.range_std_m, settings.outlier_m)


def _measure_velocity(tag: TagInfo, tracked: TrackedRanges, settings: LocateSettings) -> MeasuredVelocity | None:
    if tag.body_motion is None:
        return None
    return measure_velocity(tag.body_motion, tracked.track, tag.x_m, tag.y_m, causal=not settings.smooth)


def _locate_on_side(ranges: RangeSeries, anchors: Anchors, tag: TagInfo, settings: LocateSettings) -> TagResult:
    """With anchors on a line: the track keeps to the side it starts on, and the fixes to the track's.

    Heights are as given, fixes are of maximum likelihood, and biases are not estimated.
    """
    assert settings.mirror != "refuse"
    epoch_s, epochs = _epochs(ranges, anchors, tag, settings)
    unbiased_m = epochs.range_m - anchors.known_bias_m
    seen = anchors.position_m, unbiased_m, tag.height_m, settings.range_std_m
    first = solve_on_side(*seen, settings.outlier_m, start_on_side(*seen, settings.mirror))
    known = _Known(_rows(ranges, anchors, tag), anchors, tag, settings, 0.0, anchors.known_bias_m, None)
    tracked = known.track(epochs, first)
    velocity = _measure_velocity(tag, tracked, settings)
    if velocity is not None and velocity.series is not None:
        tracked = known.track(epochs, first, velocity.series)
    track = tracked.track
    start_m, _, _ = interpolate_poses(epochs.t_ns, track.t_ns, track.position_m, np.zeros(len(track)), epoch_s)
    fixes = solve_on_side(*seen, settings.outlier_m, start_m)
    return _result(known, epoch_s, epochs, fixes, tracked, velocity)


def _epochs(ranges: RangeSeries, anchors: Anchors, tag: TagInfo, settings: LocateSettings) -> tuple[float, Epochs]:
    epoch_s = settings.epoch_s
    if epoch_s is None:
        epoch_s = derive_epoch_s(ranges, tag.id, anchors.ids)
    return epoch_s, group_epochs(ranges, tag.id, anchors.ids, epoch_s)


@dataclass(frozen=True, slots=True)
class _Rows:
    """The usable ranges of one tag; column: each range's anchor as an index into the anchors."""

    t_ns: Int
    anchor: Int
    column: Int
    range_m: Float


def _rows(ranges: RangeSeries, anchors: Anchors, tag: TagInfo) -> _Rows:
    mine = ranges.tag == tag.id
    anchor = ranges.anchor[mine]
    order = np.argsort(anchors.ids)
    return _Rows(
        ranges.t_ns[mine], anchor, order[np.searchsorted(anchors.ids, anchor, sorter=order)], ranges.range_m[mine]
    )


@dataclass(frozen=True, slots=True)
class _Known:
    """What is known of a tag before it is tracked: its ranges, and the biases (A,) to subtract from them."""

    rows: _Rows
    anchors: Anchors
    tag: TagInfo
    settings: LocateSettings
    height_std_m: float
    bias_m: Float
    calibration: Calibration | None

    @property
    def shared_m(self) -> float:
        """The bias that all links share, where a smoother estimates it with the track."""
        return self.calibration.shared_m if self.calibration is not None and self.settings.smooth else 0.0

    def calibrated(self, epochs: Epochs, flat: Fixes) -> _Known:
        """With what the whole log shows of the ranges beyond the known biases; starts from fixes at a given height."""
        rows, start, settings = self.rows, flat.solved & ~flat.outlier, self.settings
        calibration = calibrate_links(
            rows.t_ns,
            rows.column,
            rows.range_m - self.bias_m[rows.column],
            self.anchors.position_m,
            self.tag.height_m,
            epochs.last_ns[start],
            flat.position_m[start],
            range_std_m=settings.range_std_m,
            acceleration_std_mps2=settings.acceleration_std_mps2,
            tag_height_std_m=self.height_std_m,
            apply=settings.calibrate,
        )
        return replace(self, bias_m=self.bias_m + calibration.bias.applied_m, calibration=calibration)

    def track(self, epochs: Epochs, fixes: Fixes, velocity: VelocitySeries | None = None) -> TrackedRanges:
        """The tag's track, its predictions with the biases in them."""
        rows, start, settings = self.rows, fixes.solved & ~fixes.outlier, self.settings
        known = self.calibration
        bias_m, usual_m = self.bias_m + self.shared_m, None
        if known is not None and settings.smooth:
            usual_m = known.usual_m - self.shared_m
        tracked = track_ranges(
            rows.t_ns,
            rows.column,
            rows.range_m - bias_m[rows.column],
            self.anchors.position_m,
            self.tag.height_m,
            epochs.last_ns[start],
            fixes.position_m[start],
            range_std_m=settings.range_std_m,
            acceleration_std_mps2=settings.acceleration_std_mps2,
            smooth=settings.smooth,
            tag_height_std_m=self.height_std_m,
            velocity=velocity,
            usual_m=usual_m,
            spread=None if known is None else known.spread,
        )
        return replace(tracked, predicted_m=tracked.predicted_m + bias_m[rows.column])


def _result(
    known: _Known,
    epoch_s: float,
    epochs: Epochs,
    fixes: Fixes,
    tracked: TrackedRanges,
    velocity: MeasuredVelocity | None,
) -> TagResult:
    rows, height_solved = known.rows, known.height_std_m > 0
    fewest = 4 if height_solved else 3
    bias = known.calibration.bias if known.calibration is not None and known.settings.calibrate else None
    return TagResult(
        tag=known.tag.id,
        height_m=known.tag.height_m,
        epoch_s=epoch_s,
        height_solved=height_solved,
        fix_t_ns=epochs.t_ns,
        fixes=fixes,
        ranges=RangeRows(rows.t_ns, rows.anchor, rows.range_m, tracked.predicted_m, tracked.weight),
        track=tracked.track,
        bias=bias,
        bias_m=known.bias_m,
        shared_m=known.shared_m,
        n_too_few=int((fixes.n_ranges < fewest).sum()),
        n_degenerate=int(fixes.degenerate.sum()),
        n_untracked=int(np.isnan(tracked.predicted_m).sum()),
        restart_ns=tracked.restart_ns,
        n_ranges=tracked.n_ranges,
        nis=tracked.nis,
        epochs=epochs,
        velocity=velocity,
    )
