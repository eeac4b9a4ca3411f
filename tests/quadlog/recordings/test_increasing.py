from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.recordings.clock import increasing_rows

TIMES = st.lists(st.integers(-5, 12), max_size=11)


def brute_force(times: list[int]) -> int:
    """The most rows that increase, of all subsets."""
    for size in range(len(times), 0, -1):
        if any(all(a < b for a, b in pairwise(rows)) for rows in combinations(times, size)):
            return size
    return 0


@given(TIMES)
def test_as_many_rows_as_can_be(times: list[int]) -> None:
    rows = increasing_rows(np.array(times, np.int64))
    assert (np.diff(rows) > 0).all()
    assert (np.diff(np.array(times, np.int64)[rows]) > 0).all()
    assert len(rows) == brute_force(times)


@given(TIMES)
def test_of_equal_stamps_the_first(times: list[int]) -> None:
    times = sorted(times)
    rows = increasing_rows(np.array(times, np.int64))
    assert rows.tolist() == [times.index(each) for each in sorted(set(times))]


def test_one_far_stamp_costs_itself() -> None:
    times = np.arange(100)
    times[4] = 10**18
    assert increasing_rows(times).tolist() == [i for i in range(100) if i != 4]
