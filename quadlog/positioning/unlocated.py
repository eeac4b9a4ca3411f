"""Where a track has no position: the one rule on how long a position may go without a measurement."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Int

MAX_UNMEASURED_NS = 1_000_000_000
"""Past so long without a match, a stance or a message there is no position."""
MOST_UNLOCATED = 0.05
"""Share of a log without positions above which they count as lost."""


def located_rows(t_ns: Int, measured: np.ndarray) -> np.ndarray:
    """(N,) bool: rows of a track at most MAX_UNMEASURED_NS after one that was measured, (N,) bool."""
    last_ns = np.maximum.accumulate(np.where(measured, t_ns, np.iinfo(np.int64).min // 2))
    return t_ns - last_ns <= MAX_UNMEASURED_NS


def segment_of(at_ns: Int, t_ns: Int, most_s: float = 0.0) -> Int:
    """(M,) in which part of a track (N,) instants lie, from 0; gaps over MAX_UNMEASURED_NS, and most_s, end a part."""
    ends = np.diff(t_ns) > max(MAX_UNMEASURED_NS, most_s * 1e9)
    return np.searchsorted(t_ns[1:][ends], at_ns, side="right")


def unlocated_ns(t_ns: Int, first_ns: int, last_ns: int) -> int:
    """Time of a log from first_ns to last_ns in gaps of more than MAX_UNMEASURED_NS between positions (N,)."""
    gaps_ns = np.diff(np.concatenate([[first_ns], np.clip(t_ns, first_ns, last_ns), [last_ns]]))
    return int(gaps_ns[gaps_ns > MAX_UNMEASURED_NS].sum())
