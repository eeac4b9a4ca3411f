from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.metrics.summary import worst_instants

S = 1_000_000_000


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
