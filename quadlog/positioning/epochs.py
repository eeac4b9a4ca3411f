"""Ranges of a log: which of them are used, and which of one tag are gathered into an epoch for a fix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.errors import TooLarge
from quadlog.messages import UNITS_M, Float, Int, RangeSeries

MAX_CELLS = 100_000_000
"""Largest number of epochs times anchors that is allocated."""
USUAL_EPOCH_S = 0.05
"""Long enough for frames and fast rounds, in which a walker moves less than a range's std."""
LONGEST_EPOCH_S = 1.0
"""Bound of the derived length: in a slower round a walker moves too far for a fix to mean anything."""
FEWEST = 5
"""Fewer ranges that equal the one right before may do so by chance, as cm are coarse, and fewer pairs fit any unit."""


@dataclass(frozen=True, slots=True)
class RangeCounts:
    """What became of the ranges of a log; every range is counted once, under the first cause that applies.

    other_tags, unknown_anchors: (id, ranges) for ids that were seen, but not configured.
    not_positive: zero or negative; too_short, too_long: outside [min_range_m, max_range_m].
    repeated: those that were sent, relayed or recorded again. silent_anchors: configured ones that no range came from.
    """

    total: int
    used: int
    other_tags: tuple[tuple[int, int], ...]
    unknown_anchors: tuple[tuple[int, int], ...]
    not_finite: int
    not_positive: int
    too_short: int
    too_long: int
    repeated: int
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
    repeated = _repeated(ranges.rows(kept))
    kept = kept[~repeated]
    seen = len(ranges), len(kept), other_tags, unknown_anchors
    left_out = counts[0], counts[1], counts[2], counts[3], int(repeated.sum())
    return ranges.rows(kept), RangeCounts(*seen, *left_out, silent)


def _repeated(ranges: RangeSeries) -> np.ndarray:
    """(N,) bool, of ranges in time order: those equal to one of their link right before, where most such are equal."""
    repeated, order = np.zeros(len(ranges), dtype=bool), np.lexsort((ranges.anchor, ranges.tag))
    link = np.column_stack([ranges.tag, ranges.anchor])[order]
    for rows in np.split(order, np.flatnonzero((link[1:] != link[:-1]).any(axis=1)) + 1):
        t_ns, range_m = ranges.t_ns[rows], ranges.range_m[rows]
        close_ns = _close_ns(t_ns)
        by_value = np.lexsort((t_ns, range_m))
        same = (np.diff(range_m[by_value]) == 0) & (np.diff(t_ns[by_value]) <= close_ns)
        if same.sum() >= max(FEWEST, np.count_nonzero(np.diff(t_ns) <= close_ns) / 2):
            repeated[rows[by_value[1:][same]]] = True
    return repeated


def _close_ns(t_ns: Int) -> float:
    """How near ranges of a link, at t_ns (N,) in time order, may be of one measurement: a fraction of a usual round."""
    if len(t_ns) < 3:
        return 0.0
    return min(USUAL_EPOCH_S * 1e9, float(np.quantile(t_ns[2:] - t_ns[:-2], 0.6)) / 5)


def likely_unit(ranges: RangeSeries, anchor_ids: Int, position_m: Float) -> str:
    """Unit in which most ranges of one tag, in time order, fit anchors (A,) at position_m (A, 3); empty where none is.

    Two ranges to different anchors differ by at most, and add up to at least, the distance between these.
    """
    known = np.isin(ranges.anchor, anchor_ids) & np.isfinite(ranges.range_m) & (ranges.range_m > 0)
    heard, order = ranges.rows(known), np.argsort(anchor_ids)
    place_m = position_m[order[np.searchsorted(anchor_ids, heard.anchor, sorter=order)]]
    apart_m, r = np.linalg.norm(np.diff(place_m, axis=0), axis=1), heard.range_m
    pair = (apart_m > 0) & (np.diff(heard.t_ns) <= LONGEST_EPOCH_S * 1e9)
    if pair.sum() < FEWEST:
        return ""
    difference, total, apart_m = np.abs(np.diff(r))[pair], (r[1:] + r[:-1])[pair], apart_m[pair]
    # With room for noise, blocked views and a few steps between the two.
    fits = {
        unit: ((difference * scale <= 1.5 * np.maximum(apart_m, 1)) & (total * scale >= 0.5 * apart_m)).mean()
        for unit, scale in UNITS_M.items()
    }
    best = max(fits, key=lambda unit: float(fits[unit]))
    return best if fits[best] > 0.5 else ""


def _count_ids(ids: Int) -> tuple[tuple[int, int], ...]:
    return tuple(zip(*(each.tolist() for each in np.unique(ids, return_counts=True)), strict=True))


@dataclass(frozen=True, slots=True)
class Epochs:
    """Ranges of one tag to A anchors, gathered at E instants.

    t_ns, last_ns: (E,) mean time of the ranges of each epoch, in time order, and of the last: when all were known.
    range_m: (E, A), NaN where absent.
    """

    t_ns: Int
    last_ns: Int
    range_m: Float

    def __len__(self) -> int:
        return len(self.t_ns)


def group_epochs(ranges: RangeSeries, tag: int, anchor_ids: Int, epoch_s: float | None) -> tuple[Epochs, float]:
    """Epochs of one tag, columns in the order of anchor_ids (A,), A > 0; ranges of other tags or anchors are left out.

    ranges: in time order. Consecutive stamps within epoch_s of the first join one epoch, until an anchor would come
    twice: that starts the next one, within a stamp only where that holds the anchor twice. So a frame with all anchors
    is an epoch by itself, and single asynchronous ranges make a round. Where less than half of those epochs would give
    a fix, as where each ranging is tried twice, ranges of an anchor that follow closely stay together, as their mean.

    The second value is epoch_s, or what it is derived to be where it is None: USUAL_EPOCH_S unless less than half of
    those epochs would give a fix either. Then single ranges come slower: long enough for a round, which is the median
    over the anchors heard of the median time between one anchor's ranges, within USUAL_EPOCH_S and LONGEST_EPOCH_S.

    Raises TooLarge where epochs times anchors would exceed MAX_CELLS.
    """
    order = np.argsort(anchor_ids, kind="stable")
    column = order[np.searchsorted(anchor_ids, ranges.anchor, sorter=order).clip(max=len(anchor_ids) - 1)]
    mine = (ranges.tag == tag) & (anchor_ids[column] == ranges.anchor)
    t_ns, column, range_m = ranges.t_ns[mine], column[mine], ranges.range_m[mine]
    of_tag, given_s = (tag, len(anchor_ids)), USUAL_EPOCH_S if epoch_s is None else epoch_s
    stamps = [t_ns[column == k] for k in range(len(anchor_ids))]
    close_ns = np.array([_close_ns(each) for each in stamps])
    for together_ns in (np.full(len(stamps), -1.0), close_ns):
        epochs = _gather(t_ns, column, range_m, of_tag, given_s, together_ns)
        if 2 * np.count_nonzero(np.isfinite(epochs.range_m).sum(axis=1) >= 3) >= len(epochs):
            return epochs, given_s
    if epoch_s is not None:
        return epochs, given_s
    gaps_ns = [gap_ns[gap_ns > close] for gap_ns, close in zip(map(np.diff, stamps), close_ns, strict=True)]
    periods_s = [float(np.median(each)) * 1e-9 for each in gaps_ns if len(each)]
    derived_s = float(np.clip(np.median(periods_s), USUAL_EPOCH_S, LONGEST_EPOCH_S)) if periods_s else USUAL_EPOCH_S
    return _gather(t_ns, column, range_m, of_tag, derived_s, close_ns), derived_s


def _gather(
    t_ns: Int, column: Int, range_m: Float, tag_and_width: tuple[int, int], epoch_s: float, close_ns: Float
) -> Epochs:
    """Epochs of ranges of one tag, in time order, in their columns; close_ns: see _first_of_epochs."""
    tag, width = tag_and_width
    first = _first_of_epochs(t_ns, column, round(epoch_s * 1e9), close_ns)
    if len(first) * width > MAX_CELLS:
        raise TooLarge(f"UWB epochs times anchors of tag {tag}", len(first) * width, MAX_CELLS)
    size = np.diff(np.append(first, len(t_ns)))
    epoch = np.repeat(np.arange(len(first)), size)
    table = np.full((len(first), width), np.nan)
    cell, which, count = np.unique(epoch * width + column, return_inverse=True, return_counts=True)
    table.flat[cell] = np.bincount(which, range_m) / count
    # The mean of the offsets, because the sum of the stamps themselves overflows.
    offset = np.bincount(epoch, t_ns - t_ns[first][epoch], len(first)) / size
    return Epochs(t_ns[first] + np.rint(offset).astype(np.int64), t_ns[first + size - 1], table)


def _first_of_epochs(t_ns: Int, column: Int, epoch_ns: int, close_ns: Float) -> Int:
    """(E,) the first range of each epoch, which ranges of a column that are no more than close_ns (A,) apart share."""
    n, order = len(t_ns), np.argsort(column, kind="stable")
    # An epoch ends before the stamp, or the range, at which an anchor of its comes again.
    again, same = np.full(n, n), np.diff(column[order]) == 0
    same &= np.diff(t_ns[order]) > close_ns[column[order][:-1]]
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
