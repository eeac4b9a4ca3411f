"""Ranges that cannot be used, counted by cause: nothing disappears in silence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Int, RangeSeries


@dataclass(frozen=True, slots=True)
class RangeCounts:
    """What became of the ranges of a log; every range is counted once, under the first cause that applies.

    other_tags, unknown_anchors: (id, ranges) for ids that were seen, but not configured.
    not_positive: zero or negative; too_short, too_long: outside [min_range_m, max_range_m].
    silent_anchors: configured anchors that no range came from.
    """

    total: int
    used: int
    other_tags: tuple[tuple[int, int], ...]
    unknown_anchors: tuple[tuple[int, int], ...]
    not_finite: int
    not_positive: int
    too_short: int
    too_long: int
    silent_anchors: tuple[int, ...]

    @property
    def dropped(self) -> int:
        """Ranges of the configured tags that could not be used."""
        return self.total - self.used - sum(n for _, n in self.other_tags)


def screen_ranges(
    ranges: RangeSeries, tags: Int, anchor_ids: Int, min_range_m: float, max_range_m: float
) -> tuple[RangeSeries, RangeCounts]:
    """The usable ranges of the given tags and anchors, in time order, and the count of what was left out."""
    left = np.isin(ranges.tag, tags)
    other_tags = _count_ids(ranges.tag[~left])
    known = np.isin(ranges.anchor, anchor_ids)
    unknown_anchors = _count_ids(ranges.anchor[left & ~known])
    left &= known
    finite = np.isfinite(ranges.range_m)
    range_m = np.where(finite, ranges.range_m, 0.0)
    bad_by_cause = {
        "not_finite": ~finite,
        "not_positive": range_m <= 0,
        "too_short": range_m < min_range_m,
        "too_long": range_m > max_range_m,
    }
    counted = {}
    for cause, bad in bad_by_cause.items():
        counted[cause] = int((left & bad).sum())
        left &= ~bad
    silent = tuple(int(i) for i in anchor_ids[~np.isin(anchor_ids, ranges.anchor)])
    counts = RangeCounts(
        total=len(ranges),
        used=int(left.sum()),
        other_tags=other_tags,
        unknown_anchors=unknown_anchors,
        silent_anchors=silent,
        **counted,
    )
    kept = np.flatnonzero(left)
    kept = kept[np.argsort(ranges.t_ns[kept], kind="stable")]
    return RangeSeries(ranges.t_ns[kept], ranges.tag[kept], ranges.anchor[kept], ranges.range_m[kept]), counts


def _count_ids(ids: Int) -> tuple[tuple[int, int], ...]:
    seen, n = np.unique(ids, return_counts=True)
    return tuple((int(i), int(k)) for i, k in zip(seen, n, strict=True))
