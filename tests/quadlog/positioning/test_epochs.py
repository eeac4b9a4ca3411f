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
from quadlog.positioning.epochs import LONGEST_EPOCH_S, USUAL_EPOCH_S, group_epochs, likely_unit, screen_ranges

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
    """Every range has a number of its own as its value; those of another tag and anchor are left out.

    Most epochs are frames, so that ranges of an anchor that follow closely are no second tries.
    """
    rows = rows + [(1000 * k, anchor) for k in range(1, 42) for anchor in range(4)]
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
    left_out += counts.repeated
    assert counts.total == len(rows) == counts.used + left_out
    assert counts.used == len(kept)
    assert (np.diff(kept.t_ns) >= 0).all()
    assert ((kept.range_m >= 0.05) & (kept.range_m <= 300)).all()


MS = 1_000_000
CORNERS_M = np.array([(0.0, 0.0, 1.2), (8.0, 0.0, 1.2), (8.0, 7.0, 1.2), (0.0, 7.0, 1.2)])


def walk(count: int = 60, period_ns: int = 100 * MS, digits: int = 6, jitter_ns: int = 0) -> RangeSeries:
    """Rounds of single ranges to CORNERS_M (anchors 10 to 13) of a walker."""
    rng, rows = np.random.default_rng(0), []
    for i in range(count):
        at_m = np.array([4 + 2 * np.sin(i / 10), 3 + np.cos(i / 10), 0.6])
        t_ns = BIG_NS + i * period_ns + int(rng.integers(0, jitter_ns + 1))
        for k, range_m in enumerate(np.linalg.norm(CORNERS_M - at_m, axis=1) + 0.05 * rng.standard_normal(4)):
            rows.append((t_ns + 2 * MS * k, 0, 10 + k, round(float(range_m), digits)))
    return series(rows)


def again(ranges: RangeSeries, late_ns: list[int], every: int = 1, off_m: float = 0.0) -> RangeSeries:
    """With further copies of every so many ranges, so much later."""
    rows = list(zip(ranges.t_ns, ranges.tag, ranges.anchor, ranges.range_m, strict=True))
    copies = [(t + late, *ids, r + off_m) for t, *ids, r in rows[::every] for late in late_ns]
    return series(sorted(rows + copies, key=lambda row: row[0]))


@pytest.mark.parametrize(
    ("late_ns", "every"),
    [([0], 1), ([1], 1), ([MS], 1), ([5 * MS], 1), ([15 * MS], 1), ([MS], 3), ([MS, 2 * MS], 1), ([1, MS, 2 * MS], 1)],
)
def test_ranges_that_are_sent_again_count_once(late_ns, every):
    once = walk()
    kept, counts = screen_ranges(again(once, late_ns, every), np.array([0]), np.arange(10, 14), 0.05, 300.0)
    assert counts.repeated == len(late_ns) * len(range(0, len(once), every))
    for name in ("t_ns", "anchor", "range_m"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(once, name))


@pytest.mark.parametrize(
    ("period_ns", "digits", "jitter_ns"), [(10 * MS, 2, 9 * MS), (100 * MS, 1, 0), (13 * MS, 1, MS)]
)
def test_ranges_that_are_equal_by_chance_are_kept(period_ns, digits, jitter_ns):
    """As a radio that rounds to cm or dm sends them, at irregular times."""
    ranges = walk(600, period_ns, digits, jitter_ns)
    assert screen_ranges(ranges, np.array([0]), np.arange(10, 14), 0.05, 300.0)[1].repeated == 0


@pytest.mark.parametrize(
    ("late_ns", "period_ns", "epoch_s"), [(1, 100 * MS, None), (MS, 100 * MS, 0.05), (MS, 200 * MS, None)]
)
def test_a_second_try_joins_the_epoch_of_the_first(late_ns, period_ns, epoch_s):
    once = walk(period_ns=period_ns)
    ranges = again(once, [late_ns], off_m=0.2)
    epochs, _ = group_epochs(ranges, 0, np.arange(10, 14), epoch_s)
    np.testing.assert_allclose(epochs.range_m, once.range_m.reshape(-1, 4) + 0.1)
    assert screen_ranges(ranges, np.array([0]), np.arange(10, 14), 0.05, 300.0)[1].repeated == 0


@pytest.mark.parametrize("extent", [0.2, 1.0, 8.0])
@pytest.mark.parametrize(("scale", "unit"), [(1, "m"), (100, "cm"), (1000, "mm"), (30_000, ""), (0.01, "")])
def test_the_unit_of_ranges_is_seen_by_the_anchors(extent, scale, unit):
    ranges, ids = walk(), np.arange(10, 14)
    scaled = RangeSeries(ranges.t_ns, ranges.tag, ranges.anchor, ranges.range_m * extent * scale)
    assert likely_unit(scaled, ids, CORNERS_M * extent) == unit
    assert likely_unit(scaled.rows(slice(4)), ids, CORNERS_M * extent) == ""
    scaled.range_m[np.arange(len(scaled)) % 5 != 0] = 60.0 * extent
    assert likely_unit(scaled, ids, CORNERS_M * extent) in ("", "m")
