from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.messages import RangeSeries
from quadlog.positioning.epochs import screen_ranges

TAGS, ANCHORS = np.array([0, 3]), np.array([10, 11, 12])


def screen(rows):
    t_ns, tag, anchor, range_m = (np.array(column) for column in zip(*rows, strict=True))
    series = RangeSeries(t_ns.astype(np.int64), tag.astype(np.int64), anchor.astype(np.int64), range_m.astype(float))
    return screen_ranges(series, TAGS, ANCHORS, 0.05, 300.0)


def test_every_cause_is_counted_and_every_stranger_named():
    kept, counts = screen(
        [
            (0, 0, 10, 1.0),
            (1, 0, 10, np.nan),
            (2, 0, 10, np.inf),
            (3, 0, 11, 0.0),
            (4, 0, 11, -2.0),
            (5, 0, 11, 0.01),
            (6, 0, 11, 301.0),
            (7, 0, 77, 1.0),
            (8, 0, 77, 1.0),
            (9, 3, 78, 1.0),
            (10, 5, 10, 1.0),
            (11, 3, 10, 300.0),
        ]
    )
    np.testing.assert_array_equal(kept.t_ns, [0, 11])
    assert (counts.total, counts.used) == (12, 2)
    assert (counts.not_finite, counts.not_positive, counts.too_short, counts.too_long) == (2, 2, 1, 1)
    assert counts.unknown_anchors == ((77, 2), (78, 1))
    assert counts.other_tags == ((5, 1),)
    assert counts.silent_anchors == (12,)


range_m = st.floats(-1, 400) | st.sampled_from([np.nan, np.inf, -np.inf, 0.0])


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 4), st.integers(9, 13), range_m), min_size=1, max_size=40))
def test_every_range_is_counted_exactly_once(rows):
    kept, counts = screen(rows)
    strangers = sum(n for _, n in counts.other_tags + counts.unknown_anchors)
    left_out = strangers + counts.not_finite + counts.not_positive + counts.too_short + counts.too_long
    assert counts.total == len(rows) == counts.used + left_out
    assert counts.used == len(kept)
    assert (np.diff(kept.t_ns) >= 0).all()
    assert ((kept.range_m >= 0.05) & (kept.range_m <= 300)).all()
