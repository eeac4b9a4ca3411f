"""Ranges of a log: which are used, and which of them make one fix."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import TooLarge
from quadlog.messages import RangeSeries
from quadlog.positioning import epochs as epochs_module
from quadlog.positioning.epochs import LONGEST_EPOCH_S, USUAL_EPOCH_S, group_epochs, screen_ranges

BIG_NS = 1_700_000_000_000_000_000


def series(rows: list[tuple[int, int, int, float]]) -> RangeSeries:
    t_ns, tag, anchor, range_m = zip(*rows, strict=True) if rows else ((), (), (), ())
    ids = [np.array(column, dtype=np.int64) for column in (t_ns, tag, anchor)]
    return RangeSeries(*ids, np.array(range_m, dtype=np.float64))


def rounds(interval_ms: int, anchors: int, count: int = 200, lost: float = 0.0) -> RangeSeries:
    """Single ranges to each anchor in turn, some of them lost."""
    heard = np.random.default_rng(0).random(count) >= lost
    return series([(BIG_NS + i * interval_ms * 10**6, 0, i % anchors, 1.0) for i in range(count) if heard[i]])


@pytest.mark.parametrize(
    ("interval_ms", "anchors", "lost", "epoch_s"),
    [(50, 4, 0.0, 0.2), (50, 4, 0.2, 0.2), (400, 4, 0.0, LONGEST_EPOCH_S), (10, 4, 0.0, USUAL_EPOCH_S)],
)
def test_epochs_are_as_long_as_a_slow_round(interval_ms, anchors, lost, epoch_s):
    ids, ranges = np.arange(anchors), rounds(interval_ms, anchors, lost=lost)
    assert group_epochs(ranges, 0, ids, None)[1] == pytest.approx(epoch_s)
    if epoch_s == 0.2:
        heard = np.isfinite(group_epochs(ranges, 0, ids, None)[0].range_m).sum(axis=1)
        assert (heard >= 3).mean() > (0.99 if lost == 0 else 0.7)


def test_a_rare_anchor_frames_and_lone_ranges_do_not_stretch_the_epochs():
    slow = rounds(50, 5)
    kept = (slow.anchor < 4) | (np.arange(200) % 50 == 0)
    slow = RangeSeries(*(getattr(slow, name)[kept] for name in ("t_ns", "tag", "anchor", "range_m")))
    assert group_epochs(slow, 0, np.arange(5), None)[1] == pytest.approx(0.25)
    for ranges in ([(i * 10**9, 0, a, 1.0) for i in range(10) for a in range(4)], [], [(0, 0, 1, 1.0)]):
        assert group_epochs(series(ranges), 0, np.arange(4), None)[1] == USUAL_EPOCH_S


def test_too_many_cells_are_refused(monkeypatch):
    monkeypatch.setattr(epochs_module, "MAX_CELLS", 5)
    with pytest.raises(TooLarge, match="tag 0: 6 exceeds the limit of 5"):
        group_epochs(series([(0, 0, 1, 1.0), (0, 0, 1, 1.0)]), 0, np.arange(1, 4), 0.1)


def grouped(rows: list[tuple[int, int]], epoch_ns: int) -> list[list[int]]:
    """The rule, one stamp after the other: rows (t_ns, anchor) as lists of their indices."""
    epochs: list[list[int]] = []
    for t_ns, stamp in groupby(range(len(rows)), key=lambda i: rows[i][0]):
        together = list(stamp)
        heard = {rows[i][1] for i in epochs[-1]} if epochs else set()
        if not epochs or t_ns - rows[epochs[-1][0]][0] > epoch_ns or heard & {rows[i][1] for i in together}:
            epochs.append([])
        for i in together:
            if rows[i][1] in {rows[j][1] for j in epochs[-1]}:
                epochs.append([])
            epochs[-1].append(i)
    return epochs


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 3)), max_size=40).map(sorted), st.integers(0, 30))
def test_epochs_follow_the_rule_and_lose_no_range(rows, epoch_ns):
    """Every range has a number of its own as its value; those of another tag and anchor are left out."""
    own = [(BIG_NS + t, 1, a, float(i)) for i, (t, a) in enumerate(rows)]
    strangers = [(t, *which, 99.0) for t, *_ in own[::3] for which in ((0, 2), (1, 7))]
    got = group_epochs(series(sorted(own + strangers, key=lambda row: row[0])), 1, np.arange(4), epoch_ns * 1e-9)[0]
    held = [sorted(row[np.isfinite(row)].astype(int).tolist()) for row in got.range_m]
    assert held == grouped(rows, epoch_ns)
    for t_ns, last_ns, members in zip(got.t_ns, got.last_ns, held, strict=True):
        times = [rows[i][0] for i in members]
        assert max(times) == last_ns - BIG_NS
        assert abs(np.mean(times) - (t_ns - BIG_NS)) <= 0.5


def screen(rows):
    return screen_ranges(series(rows), np.array([0, 3]), np.array([10, 11, 12]), 0.05, 300.0)


range_m = st.floats(-1, 400) | st.sampled_from([np.nan, np.inf, -np.inf, 0.0])


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 4), st.integers(9, 13), range_m), max_size=40))
def test_every_range_is_counted_exactly_once(rows):
    kept, counts = screen(rows)
    strangers = sum(n for _, n in counts.other_tags + counts.unknown_anchors)
    left_out = strangers + counts.not_finite + counts.not_positive + counts.too_short + counts.too_long
    assert counts.total == len(rows) == counts.used + left_out
    assert counts.used == len(kept)
    assert (np.diff(kept.t_ns) >= 0).all()
    assert ((kept.range_m >= 0.05) & (kept.range_m <= 300)).all()
