"""Which of a topic's stamps are kept: late ones are sorted in, and those of a clock that was set back are left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.recordings.clock import LATE_NS, kept_rows, repeated_rows

MS = 10**6


def stamps(*ms: int) -> np.ndarray:
    return np.array(ms, dtype=np.int64) * MS


@pytest.mark.parametrize(
    ("t_ns", "left_out"),
    [
        (stamps(), []),
        (stamps(0, 0, 100, 100), []),
        (stamps(0, 1000, 300, 2000), []),  # overtaken by 700 ms
        (np.concatenate([np.arange(0, 100), np.arange(60, 160)]) * 100 * MS, list(range(100, 140))),
        (stamps(*range(0, 1000, 100), 9000, *range(1000, 3000, 100)), [10]),  # one that ran ahead
        (stamps(9000, *range(0, 3000, 100)), [0]),
        (stamps(*range(0, 3000, 100), 500, *range(3000, 5000, 100)), [30]),  # one that is late
        (stamps(0, 1000, 2000, 3000, 1500, 4000, 5000), [4]),
        (stamps(*range(0, 1000, 100), 9000, 9100, 9200, 9300, *range(1000, 3000, 100)), [10, 11, 12, 13]),
        (stamps(0, 3000, 2200, 2300, 2400, 2500, 2600, 1500, 3100), [7]),  # late ones, and then one too late
        (stamps(9000, *range(0, 3000, 100), *range(500, 4000, 100)), [0, *range(31, 56)]),  # one ahead, then set back
    ],
)
def test_repeated_rows(t_ns, left_out):
    assert np.flatnonzero(repeated_rows(t_ns)).tolist() == left_out


def test_of_a_clock_set_back_twice_the_first_passage_stays():
    t_ns = np.concatenate([np.arange(0, 50), np.arange(30, 60), np.arange(10, 80)]) * 100 * MS
    assert t_ns[~repeated_rows(t_ns)].tolist() == (np.arange(0, 80) * 100 * MS).tolist()


@given(st.lists(st.integers(0, 400), max_size=40))
def test_kept_stamps_go_back_by_no_more_than_messages_may_overtake(tenths):
    t_ns = stamps(*(100 * each for each in tenths))
    kept = t_ns[~repeated_rows(t_ns)]
    assert bool(len(kept)) == bool(len(t_ns))
    assert (kept >= np.maximum.accumulate(kept) - LATE_NS).all()


@given(st.lists(st.integers(0, 10), max_size=20))
def test_late_stamps_are_sorted_in_and_the_first_of_equal_ones_is_kept(tenths):
    t_ns = stamps(*(100 * each for each in tenths))
    rows = kept_rows(t_ns)
    assert rows.tolist() == [tenths.index(each) for each in sorted(set(tenths))]
