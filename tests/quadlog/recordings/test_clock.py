"""Which of a topic's stamps are kept: those that increase, and those of a clock that was set back."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.recordings.clock import REORDERED_NS, backward_steps, increasing_rows, repeated_rows

TIMES = st.lists(st.integers(-5, 12), max_size=11)


def brute_force(times: list[int]) -> int:
    """The most rows that increase, of all subsets."""
    for size in range(len(times), 0, -1):
        if any(all(a < b for a, b in pairwise(rows)) for rows in combinations(times, size)):
            return size
    return 0


@given(TIMES)
def test_the_longest_increasing_rows_against_brute_force(times: list[int]) -> None:
    rows = increasing_rows(np.array(times, np.int64))
    assert (np.diff(rows) > 0).all()
    assert (np.diff(np.array(times, np.int64)[rows]) > 0).all()
    assert len(rows) == brute_force(times)


@given(TIMES)
def test_the_first_of_equal_stamps_is_kept(times: list[int]) -> None:
    times = sorted(times)
    rows = increasing_rows(np.array(times, np.int64))
    assert rows.tolist() == [times.index(each) for each in sorted(set(times))]


MS = 10**6


def stamps(*ms: int) -> np.ndarray:
    return np.array(ms, dtype=np.int64) * MS


@pytest.mark.parametrize(
    ("t_ns", "left_out"),
    [
        (stamps(), []),
        (stamps(0, 0, 100, 100), []),
        (stamps(0, 100, 60, 200), []),  # overtaken by 40 ms
        (np.concatenate([np.arange(0, 100), np.arange(60, 160)]) * 100 * MS, list(range(100, 140))),
        (stamps(*range(0, 1000, 100), 9000, *range(1000, 3000, 100)), [10]),  # one that ran ahead
        (stamps(9000, *range(0, 3000, 100)), [0]),
        (stamps(*range(0, 1000, 100), 500, *range(1000, 3000, 100)), [10]),  # one that is late
        (stamps(*range(0, 1000, 100), 9000, 9100, 9200, 9300, *range(1000, 3000, 100)), [10, 11, 12, 13]),
    ],
)
def test_repeated_rows(t_ns, left_out):
    assert np.flatnonzero(repeated_rows(t_ns)).tolist() == left_out


def test_of_a_clock_set_back_twice_the_first_passage_stays():
    t_ns = np.concatenate([np.arange(0, 50), np.arange(30, 60), np.arange(10, 80)]) * 100 * MS
    kept = t_ns[~repeated_rows(t_ns)]
    assert kept.tolist() == (np.arange(0, 80) * 100 * MS).tolist()
    assert backward_steps(t_ns).tolist() == [50, 80]


@given(st.lists(st.integers(0, 400), max_size=40))
def test_kept_stamps_do_not_go_back(ms):
    """But for what messages may overtake: twice that, as a run of small steps may end where the next begins."""
    t_ns = stamps(*ms)
    repeated = repeated_rows(t_ns)
    if len(backward_steps(t_ns)) == 0:
        assert not repeated.any()
    assert (len(t_ns) == 0) or not repeated.all()
    kept = t_ns[~repeated]
    assert (np.diff(kept) >= -REORDERED_NS).all()
