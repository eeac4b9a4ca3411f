"""Where every tag was: screen, group, calibrate, fix, track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.calibration import AnchorBias, estimate_anchor_bias
from quadlog.positioning.epochs import Epochs, group_epochs
from quadlog.positioning.fixes import Fixes, require_spread
from quadlog.positioning.gauss_newton import solve_gauss_newton
from quadlog.positioning.screening import RangeCounts, screen_ranges
from quadlog.positioning.tracker import Track, track_ranges


@dataclass(frozen=True, slots=True)
class Anchors:
    """A anchors in map: ids (A,), each once; position_m (A, 3); known_bias_m (A,), subtracted from every range."""

    ids: Int
    position_m: Float
    known_bias_m: Float


@dataclass(frozen=True, slots=True)
class TagInfo:
    """A tag to locate, and its height in map."""

    id: int
    height_m: float


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """How ranges become positions.

    calibrate: estimate each link's constant bias and subtract it where significant.
    smooth: tracks smoothed over the whole log. False makes every pose of the track causal given the
    biases; with calibrate the biases still come from the whole log.
    """

    range_std_m: float = 0.1
    min_range_m: float = 0.05
    max_range_m: float = 300.0
    epoch_s: float = 0.05
    outlier_m: float = 0.5
    acceleration_std_mps2: float = 1.0
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

    bias_m: (A,) what was subtracted from the ranges, known and estimated; bias: the estimate, None unless calibrated.
    n_too_few, n_degenerate: epochs without a fix; n_untracked: ranges before a track starts.
    """

    tag: int
    height_m: float
    fix_t_ns: Int
    fixes: Fixes
    ranges: RangeRows
    track: Track
    bias: AnchorBias | None
    bias_m: Float
    n_too_few: int
    n_degenerate: int
    n_untracked: int


@dataclass(frozen=True, slots=True)
class Located:
    """One result per tag, in the order asked for, and the counts of all ranges."""

    tags: tuple[TagResult, ...]
    counts: RangeCounts


def locate(ranges: RangeSeries, anchors: Anchors, tags: Sequence[TagInfo], settings: LocateSettings) -> Located:
    """Fixes and tracks of each tag by itself, from all ranges of a log.

    Raises MissingInput for fewer than three anchors, AnchorsCollinear where all
    lie on one line, TooLarge for a log beyond what is allocated.
    """
    require_spread(anchors.ids, anchors.position_m, settings.range_std_m)
    tag_ids = np.array([tag.id for tag in tags], dtype=np.int64)
    usable, counts = screen_ranges(ranges, tag_ids, anchors.ids, settings.min_range_m, settings.max_range_m)
    return Located(tuple(_locate_tag(usable, anchors, tag, settings) for tag in tags), counts)


def _locate_tag(ranges: RangeSeries, anchors: Anchors, tag: TagInfo, settings: LocateSettings) -> TagResult:
    epochs = group_epochs(ranges, tag.id, anchors.ids, settings.epoch_s)
    bias, bias_m = _find_bias(epochs, anchors, tag, settings)
    fixes = solve_gauss_newton(
        anchors.position_m, epochs.range_m - bias_m, tag.height_m, settings.range_std_m, settings.outlier_m
    )
    rows, track = _track_tag(ranges, anchors, tag, bias_m, epochs, fixes, settings)
    return TagResult(
        tag=tag.id,
        height_m=tag.height_m,
        fix_t_ns=epochs.t_ns,
        fixes=fixes,
        ranges=rows,
        track=track,
        bias=bias,
        bias_m=bias_m,
        n_too_few=int((fixes.n_ranges < 3).sum()),
        n_degenerate=int(fixes.degenerate.sum()),
        n_untracked=int(np.isnan(rows.predicted_m).sum()),
    )


def _find_bias(
    epochs: Epochs, anchors: Anchors, tag: TagInfo, settings: LocateSettings
) -> tuple[AnchorBias | None, Float]:
    if not settings.calibrate:
        return None, anchors.known_bias_m
    known = Epochs(epochs.t_ns, epochs.last_ns, epochs.range_m - anchors.known_bias_m)
    bias = estimate_anchor_bias(
        known, anchors.position_m, tag.height_m, settings.range_std_m, settings.acceleration_std_mps2
    )
    return bias, anchors.known_bias_m + bias.applied_m


def _track_tag(
    ranges: RangeSeries,
    anchors: Anchors,
    tag: TagInfo,
    bias_m: Float,
    epochs: Epochs,
    fixes: Fixes,
    settings: LocateSettings,
) -> tuple[RangeRows, Track]:
    mine = ranges.tag == tag.id
    t_ns, anchor, range_m = ranges.t_ns[mine], ranges.anchor[mine], ranges.range_m[mine]
    order = np.argsort(anchors.ids)
    column = order[np.searchsorted(anchors.ids, anchor, sorter=order)]
    start = fixes.solved & ~fixes.outlier
    tracked = track_ranges(
        t_ns,
        column,
        range_m - bias_m[column],
        anchors.position_m,
        tag.height_m,
        epochs.last_ns[start],
        fixes.position_m[start],
        range_std_m=settings.range_std_m,
        acceleration_std_mps2=settings.acceleration_std_mps2,
        smooth=settings.smooth,
    )
    rows = RangeRows(t_ns, anchor, range_m, tracked.predicted_m + bias_m[column], tracked.weight)
    return rows, tracked.track
