"""Which of a topic's messages to keep so that time goes on: as many as possible."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from quadlog.messages import Int


def increasing_rows(t_ns: Int) -> Int:
    """Rows (K,) of the times (N,) that increase strictly, as many as can be.

    Of equally many, those that come later than all before them: of two equal
    stamps the first. One stamp in the far future costs only itself.
    """
    if len(t_ns) == 0:
        return np.zeros(0, np.int64)
    in_turn = np.flatnonzero(np.concatenate([[True], t_ns[1:] > np.maximum.accumulate(t_ns)[:-1]]))
    if len(in_turn) == len(t_ns):
        return in_turn
    longest = _longest_increasing(t_ns.tolist())
    return in_turn if len(in_turn) == len(longest) else np.array(longest, np.int64)


def _longest_increasing(values: list[int]) -> list[int]:
    """Rows of a longest strictly increasing subsequence, in O(N log N) (Fredman, 1975)."""
    ends: list[int] = []  # the smallest value that ends an increasing run of length 1, 2, ...
    end_rows: list[int] = []
    before: list[int] = []
    for row, value in enumerate(values):
        length = bisect_left(ends, value)
        before.append(end_rows[length - 1] if length else -1)
        ends[length : length + 1] = [value]
        end_rows[length : length + 1] = [row]
    rows = []
    row = end_rows[-1]
    while row >= 0:
        rows.append(row)
        row = before[row]
    return rows[::-1]
