"""Ranges of one tag, screened, and gathered into epochs that one fix can be made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.errors import TooLarge
from quadlog.messages import Float, Int, RangeSeries

MAX_CELLS = 100_000_000
"""Largest number of epochs times anchors that is allocated."""
USUAL_EPOCH_S = 0.05
"""Long enough for frames and fast rounds, in which a walker moves less than a range's std."""
LONGEST_EPOCH_S = 1.0
"""Bound of the derived length: in a slower round a walker moves too far for a fix to mean anything."""


@dataclass(frozen=True, slots=True)
class Epochs:
    """Ranges of one tag to A anchors, gathered at E instants.

    t_ns: (E,) mean time of the ranges of each epoch, in time order.
    last_ns: (E,) time of the last of them: when the epoch was known in full.
    range_m: (E, A), NaN where absent.
    """

    t_ns: Int
    last_ns: Int
    range_m: Float

    def __len__(self) -> int:
        return len(self.t_ns)


def group_epochs(ranges: RangeSeries, tag: int, anchor_ids: Int, epoch_s: float) -> Epochs:
    """Epochs of one tag, columns in the order of anchor_ids (A,), A > 0; ranges of other tags or anchors are left out.

    Ranges that share a time stamp stay together. Consecutive stamps within epoch_s of the first join one epoch, until
    an anchor would come twice: that starts the next one, within a stamp too where that holds the anchor twice. So a
    frame with all anchors is an epoch by itself, and single asynchronous ranges make a round. ranges must be in time
    order.

    Raises TooLarge where epochs times anchors would exceed MAX_CELLS.
    """
    order = np.argsort(anchor_ids, kind="stable")
    column = order[np.searchsorted(anchor_ids, ranges.anchor, sorter=order).clip(max=len(anchor_ids) - 1)]
    mine = (ranges.tag == tag) & (anchor_ids[column] == ranges.anchor)
    t_ns, column, range_m = ranges.t_ns[mine], column[mine], ranges.range_m[mine]

    epoch, count = _number_epochs(t_ns, column, round(epoch_s * 1e9))
    if count * len(anchor_ids) > MAX_CELLS:
        raise TooLarge(f"UWB epochs times anchors of tag {tag}", count * len(anchor_ids), MAX_CELLS)
    table = np.full((count, len(anchor_ids)), np.nan)
    table[epoch, column] = range_m
    first = np.searchsorted(epoch, np.arange(count))
    last = np.searchsorted(epoch, np.arange(count), side="right") - 1
    # The mean of the offsets, because the sum of the stamps themselves overflows.
    offset = np.bincount(epoch, t_ns - t_ns[first][epoch], count) / np.bincount(epoch, minlength=count)
    return Epochs(t_ns[first] + np.rint(offset).astype(np.int64), t_ns[last], table)


def thin_rows(usable: np.ndarray, most: int) -> Int:
    """Indices of at most so many rows among the usable ones (E,) bool, evenly spread."""
    rows = np.flatnonzero(usable)
    return rows[:: max(1, -(-len(rows) // most))]


def derive_epoch_s(ranges: RangeSeries, tag: int, anchor_ids: Int) -> float:
    """How long the epochs of one tag should be: USUAL_EPOCH_S unless less than half of those would give a fix.

    Then single ranges come slower: long enough for a round, which is the median over the anchors (A,) heard of the
    median time between one anchor's ranges, within USUAL_EPOCH_S and LONGEST_EPOCH_S. ranges must be in time order.
    Raises TooLarge as group_epochs does.
    """
    usual = group_epochs(ranges, tag, anchor_ids, USUAL_EPOCH_S)
    if 2 * np.count_nonzero(np.isfinite(usual.range_m).sum(axis=1) >= 3) >= len(usual):
        return USUAL_EPOCH_S
    periods_s = []
    for anchor in anchor_ids:
        t_ns = np.unique(ranges.t_ns[(ranges.tag == tag) & (ranges.anchor == anchor)])
        if len(t_ns) > 1:
            periods_s.append(float(np.median(np.diff(t_ns))) * 1e-9)
    round_s = float(np.median(periods_s)) if periods_s else USUAL_EPOCH_S
    return min(max(round_s, USUAL_EPOCH_S), LONGEST_EPOCH_S)


def _number_epochs(t_ns: Int, column: Int, epoch_ns: int) -> tuple[Int, int]:
    """(N,) the epoch of each range, and how many there are."""
    count = len(t_ns)
    index = np.arange(count)
    stamp_start = np.searchsorted(t_ns, t_ns)
    before = _same_anchor_before(column)
    in_stamp = before >= stamp_start
    too_late = np.searchsorted(t_ns, t_ns + epoch_ns, side="right")
    # Where an anchor would come twice: its whole stamp moves on, unless the stamp holds that anchor twice.
    repeats = np.maximum.accumulate(np.where(in_stamp, -1, before))
    doubles = np.maximum.accumulate(np.where(in_stamp, before, -1))
    repeated, doubled = np.searchsorted(repeats, index), np.searchsorted(doubles, index)
    repeated = np.append(stamp_start, count)[repeated]
    end_of = np.minimum(np.minimum(too_late, repeated), doubled).tolist()
    starts, start = [], 0
    while start < count:
        starts.append(start)
        start = end_of[start]
    return np.searchsorted(np.array(starts, dtype=np.int64), index, side="right") - 1, len(starts)


def _same_anchor_before(column: Int) -> Int:
    """(N,) the range before each one to the same anchor, -1 for none."""
    order = np.argsort(column, kind="stable")
    before = np.full(len(column), -1, dtype=np.int64)
    same = column[order[1:]] == column[order[:-1]]
    before[order[1:][same]] = order[:-1][same]
    return before


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
