from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.metrics.summary import worst_instants

S = 1_000_000_000


def test_neighbours_of_a_worse_instant_are_not_told_again():
    t_ns = np.arange(60) * S // 10
    badness = np.zeros(60)
    badness[[20, 21, 30, 50, 51]] = [5, 4, 4.5, 1, 2]
    assert worst_instants(t_ns, badness) == [20, 30, 51]
    assert worst_instants(t_ns, badness, most=1) == [20]


def test_what_is_not_bad_is_not_worst():
    assert worst_instants(np.arange(5) * S, np.zeros(5)) == []
    assert worst_instants(np.empty(0, dtype=np.int64), np.empty(0)) == []
    assert worst_instants(np.arange(5) * S, np.array([0, 1.0, 0, 1, -1])) == [1, 3]


@given(st.lists(st.tuples(st.integers(0, 10 * S), st.floats(0, 10)), max_size=30))
def test_each_is_the_worst_of_what_is_left(rows):
    rows = sorted(rows)
    t_ns, badness = np.array([t for t, _ in rows], dtype=np.int64), np.array([b for _, b in rows])
    chosen = worst_instants(t_ns, badness)
    left = [i for i in range(len(rows)) if badness[i] > 0]
    for worst in chosen:
        assert badness[worst] == max(badness[i] for i in left)
        left = [i for i in left if abs(t_ns[i] - t_ns[worst]) >= S]
    assert len(chosen) == 3 or not left
