from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import TooLarge
from quadlog.messages import RangeSeries
from quadlog.positioning import epochs as epochs_module
from quadlog.positioning.epochs import (
    LONGEST_EPOCH_S,
    USUAL_EPOCH_S,
    derive_epoch_s,
    group_epochs,
    thin_rows,
)


def series(rows: list[tuple[int, int, int, float]]) -> RangeSeries:
    t_ns, tag, anchor, range_m = zip(*rows, strict=True) if rows else ((), (), (), ())
    ids = [np.array(column, dtype=np.int64) for column in (t_ns, tag, anchor)]
    return RangeSeries(*ids, np.array(range_m, dtype=np.float64))


def test_single_ranges_make_a_round_at_their_mean_time():
    big = 1_700_000_000_000_000_000
    rows = [(big + 0, 0, 1, 1.0), (big + 10, 0, 2, 2.0), (big + 26, 0, 3, 3.0), (big + 40, 0, 1, 1.5)]
    got = group_epochs(series(rows), 0, ids(1, 2, 3), 1e-7)
    np.testing.assert_array_equal(got.t_ns, [big + 12, big + 40])
    np.testing.assert_array_equal(got.last_ns, [big + 26, big + 40])


def test_too_many_cells_are_refused(monkeypatch):
    monkeypatch.setattr(epochs_module, "MAX_CELLS", 5)
    with pytest.raises(TooLarge, match="tag 0: 6 exceeds the limit of 5"):
        group_epochs(series([(0, 0, 1, 1.0), (0, 0, 1, 1.0)]), 0, ids(1, 2, 3), 0.1)


def rounds(interval_ms: int, anchors: int, count: int = 200, lost: float = 0.0) -> RangeSeries:
    """Single ranges to each anchor in turn, some of them lost."""
    heard = np.random.default_rng(0).random(count) >= lost
    big = 1_700_000_000_000_000_000
    return series([(big + i * interval_ms * 10**6, 0, i % anchors, 1.0) for i in range(count) if heard[i]])


@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_slow_rounds_make_long_epochs(lost):
    slow = rounds(50, 4, lost=lost)
    epoch_s = derive_epoch_s(slow, 0, ids(0, 1, 2, 3))
    assert epoch_s == pytest.approx(0.2)
    heard = np.isfinite(group_epochs(slow, 0, ids(0, 1, 2, 3), epoch_s).range_m).sum(axis=1)
    assert (heard >= 3).mean() > (0.99 if lost == 0 else 0.7)


def test_an_epoch_stays_below_its_bound():
    assert derive_epoch_s(rounds(400, 4), 0, ids(0, 1, 2, 3)) == LONGEST_EPOCH_S


def test_an_anchor_that_is_rarely_heard_does_not_stretch_the_epochs():
    slow = rounds(50, 5)
    rare = (slow.anchor == 4) & (np.arange(200) % 50 > 0)
    kept = RangeSeries(*(getattr(slow, name)[~rare] for name in ("t_ns", "tag", "anchor", "range_m")))
    assert derive_epoch_s(kept, 0, ids(0, 1, 2, 3, 4)) == pytest.approx(0.25)


def test_frames_and_fast_rounds_keep_the_usual_length():
    frames = series([(i * 10**9, 0, anchor, 1.0) for i in range(10) for anchor in range(4)])
    assert derive_epoch_s(frames, 0, ids(0, 1, 2, 3)) == USUAL_EPOCH_S
    assert derive_epoch_s(rounds(10, 4), 0, ids(0, 1, 2, 3)) == USUAL_EPOCH_S
    assert derive_epoch_s(series([]), 0, ids(0, 1, 2)) == USUAL_EPOCH_S
    assert derive_epoch_s(series([(0, 0, 1, 1.0)]), 0, ids(0, 1, 2)) == USUAL_EPOCH_S


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
def test_epochs_follow_the_rule_stamp_by_stamp(rows, epoch_ns):
    got = group_epochs(
        series([(t, 0, a, float(i)) for i, (t, a) in enumerate(rows)]), 0, ids(0, 1, 2, 3), epoch_ns * 1e-9
    )
    held = [sorted(row[np.isfinite(row)].astype(int).tolist()) for row in got.range_m]
    assert held == grouped(rows, epoch_ns)


row = st.tuples(st.integers(0, 400), st.integers(0, 1), st.integers(0, 4))


@given(st.lists(row, max_size=60), st.integers(0, 100))
def test_no_range_is_lost_or_doubled(rows, epoch_ns):
    """Every range gets a number of its own as its value; the epochs must hold exactly those of the tag and anchors."""
    rows = [(t, tag, anchor, float(i + 1)) for i, (t, tag, anchor) in enumerate(sorted(rows))]
    got = group_epochs(series(rows), 1, ids(0, 1, 2, 3), epoch_ns * 1e-9)
    expected = [value for _, tag, anchor, value in rows if tag == 1 and anchor < 4]
    held = got.range_m[np.isfinite(got.range_m)]
    assert sorted(held) == expected

    time_of = {value: t for t, _, _, value in rows}
    for t_ns, last_ns, ranges in zip(got.t_ns, got.last_ns, got.range_m, strict=True):
        times = [time_of[value] for value in ranges[np.isfinite(ranges)]]
        assert max(times) == last_ns
        assert abs(np.mean(times) - t_ns) <= 0.5
        assert max(times) - min(times) <= epoch_ns
    assert (np.diff(got.last_ns) >= 0).all()


@pytest.mark.parametrize("n", [0, 1, 200, 201, 999])
def test_rows_are_thinned_evenly(n):
    usable = np.ones(2 * n, dtype=bool)
    usable[::2] = False
    rows = thin_rows(usable, 200)
    assert usable[rows].all()
    assert min(n, 100) <= len(rows) <= 200
    assert len(np.unique(np.diff(rows))) <= 1


def ids(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)
