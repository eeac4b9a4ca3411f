"""Ranges of a log: which of them are used, and which of one tag are gathered into an epoch for a fix."""

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
    range_m, left = ranges.range_m, np.isin(ranges.tag, tags)
    other_tags, known = _count_ids(ranges.tag[~left]), np.isin(ranges.anchor, anchor_ids)
    unknown_anchors = _count_ids(ranges.anchor[left & ~known])
    left &= known
    counts = list[int]()
    for bad in (~np.isfinite(range_m), range_m <= 0, range_m < min_range_m, range_m > max_range_m):
        counts.append(int((left & bad).sum()))
        left &= ~bad
    silent = tuple(anchor_ids[~np.isin(anchor_ids, ranges.anchor)].tolist())
    kept = np.flatnonzero(left)
    kept = kept[np.argsort(ranges.t_ns[kept], kind="stable")]
    seen = len(ranges), len(kept), other_tags, unknown_anchors
    return ranges.rows(kept), RangeCounts(*seen, counts[0], counts[1], counts[2], counts[3], silent)


def _count_ids(ids: Int) -> tuple[tuple[int, int], ...]:
    return tuple(zip(*(each.tolist() for each in np.unique(ids, return_counts=True)), strict=True))


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


def group_epochs(ranges: RangeSeries, tag: int, anchor_ids: Int, epoch_s: float | None) -> tuple[Epochs, float]:
    """Epochs of one tag, columns in the order of anchor_ids (A,), A > 0; ranges of other tags or anchors are left out.

    Ranges that share a time stamp stay together. Consecutive stamps within epoch_s of the first join one epoch, until
    an anchor would come twice: that starts the next one, within a stamp too where that holds the anchor twice. So a
    frame with all anchors is an epoch by itself, and single asynchronous ranges make a round. ranges: in time order.

    The second value is epoch_s, or what it is derived to be where it is None: USUAL_EPOCH_S unless less than half of
    those epochs would give a fix. Then single ranges come slower: long enough for a round, which is the median over the
    anchors heard of the median time between one anchor's ranges, within USUAL_EPOCH_S and LONGEST_EPOCH_S.

    Raises TooLarge where epochs times anchors would exceed MAX_CELLS.
    """
    order = np.argsort(anchor_ids, kind="stable")
    column = order[np.searchsorted(anchor_ids, ranges.anchor, sorter=order).clip(max=len(anchor_ids) - 1)]
    mine = (ranges.tag == tag) & (anchor_ids[column] == ranges.anchor)
    t_ns, column, range_m = ranges.t_ns[mine], column[mine], ranges.range_m[mine]
    epochs = _gather(t_ns, column, range_m, (tag, len(anchor_ids)), USUAL_EPOCH_S if epoch_s is None else epoch_s)
    if epoch_s is not None:
        return epochs, epoch_s
    if 2 * np.count_nonzero(np.isfinite(epochs.range_m).sum(axis=1) >= 3) >= len(epochs):
        return epochs, USUAL_EPOCH_S
    stamps = [np.unique(t_ns[column == k]) for k in range(len(anchor_ids))]
    periods_s = [float(np.median(np.diff(each))) * 1e-9 for each in stamps if len(each) > 1]
    derived_s = float(np.clip(np.median(periods_s), USUAL_EPOCH_S, LONGEST_EPOCH_S)) if periods_s else USUAL_EPOCH_S
    return _gather(t_ns, column, range_m, (tag, len(anchor_ids)), derived_s), derived_s


def _gather(t_ns: Int, column: Int, range_m: Float, tag_and_width: tuple[int, int], epoch_s: float) -> Epochs:
    """Epochs of ranges of one tag, in time order, in their columns."""
    tag, width = tag_and_width
    first = _first_of_epochs(t_ns, column, round(epoch_s * 1e9))
    if len(first) * width > MAX_CELLS:
        raise TooLarge(f"UWB epochs times anchors of tag {tag}", len(first) * width, MAX_CELLS)
    size = np.diff(np.append(first, len(t_ns)))
    epoch = np.repeat(np.arange(len(first)), size)
    table = np.full((len(first), width), np.nan)
    table[epoch, column] = range_m
    # The mean of the offsets, because the sum of the stamps themselves overflows.
    offset = np.bincount(epoch, t_ns - t_ns[first][epoch], len(first)) / size
    return Epochs(t_ns[first] + np.rint(offset).astype(np.int64), t_ns[first + size - 1], table)


def _first_of_epochs(t_ns: Int, column: Int, epoch_ns: int) -> Int:
    """(E,) the first range of each epoch."""
    n, order = len(t_ns), np.argsort(column, kind="stable")
    # An epoch ends before the stamp, or the range, at which an anchor of its comes again.
    again, same = np.full(n, n), np.diff(column[order]) == 0
    again[order[:-1][same]] = order[1:][same]
    stamp = np.append(np.searchsorted(t_ns, t_ns), n)[again]
    end = np.where(stamp > np.arange(n), stamp, again)
    end = np.minimum.accumulate(end[::-1])[::-1]
    end = np.minimum(end, np.searchsorted(t_ns - epoch_ns, t_ns, side="right")).tolist()
    first, row = list[int](), 0
    while row < n:
        first.append(row)
        row = end[row]
    return np.array(first, dtype=np.int64)


def thin_rows(usable: np.ndarray, most: int) -> Int:
    """Indices of at most so many rows among the usable ones (E,) bool, evenly spread."""
    rows = np.flatnonzero(usable)
    return rows[:: max(1, -(-len(rows) // most))]
