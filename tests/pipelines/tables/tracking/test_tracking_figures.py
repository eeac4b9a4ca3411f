from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from quadlog.pipelines.tables.tracking import table_5
from quadlog.pipelines.tables.tracking.walks import (
    ETA,
    PITCH,
    TIME,
    Tracked,
    fall_row,
    mean_interval,
    mean_row,
    ratio_interval,
    ratio_row,
)


def walks(*etas_m, **figures):
    nothing = np.zeros(1)
    return [Tracked({"eta_m": eta_m, "fallen": 0.0, **figures}, nothing, nothing) for eta_m in etas_m]


FIGURES = st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=12).filter(lambda values: np.ptp(values) > 1e-3)


@given(FIGURES, st.floats(0.1, 10))
def test_the_ratio_has_the_interval_of_its_logarithms(values, factor):
    wholes = np.array(values)
    parts = factor * wholes ** np.linspace(0.9, 1.1, len(wholes))
    ratio, (low, high) = ratio_interval(parts, wholes)
    test = stats.ttest_1samp(np.log(parts / wholes), 0.0).confidence_interval(0.95)
    assert ratio == pytest.approx(stats.gmean(parts / wholes))
    assert (low, high) == pytest.approx((math.exp(test.low), math.exp(test.high)))


def test_one_seed_has_no_interval():
    assert mean_interval(np.array([2.0])) == (2.0, None)
    assert ratio_interval(np.array([3.0]), np.array([2.0])) == (pytest.approx(1.5), None)
    (row,) = ratio_row("one", ETA, walks(0.3), walks(0.2), 1.05)
    assert (row.low, row.reproduces) == (None, "undecided")


def test_a_printed_number_is_judged_by_our_interval():
    (row,) = mean_row("ideal, FpMW", ETA, walks(*[0.27, 0.28, 0.29] * 2), 0.2801, 1e-4, why_not="Why.")
    assert (row.quantity, row.reproduces, row.note) == ("ideal, FpMW: η (m)", "yes", "")
    (row,) = mean_row("ideal, FpMW", ETA, walks(0.027, 0.028, 0.029), 0.2801, 1e-4, why_not="Why.")
    assert (row.reproduces, row.note) == ("no", "Why.")
    assert row.difference == pytest.approx(-0.2521)
    (row,) = mean_row("of two", ETA, walks(0.1, 0.3), 0.2801, 1e-4, why_not="Why.")
    assert row.low < 0.2801 < row.high
    assert row.reproduces == "undecided"
    (row,) = mean_row("ideal, FpMW", ETA, walks(0.027, 0.028), 0.2801, 1e-4, why_not_comparable="Why.")
    assert (row.paper, row.reproduces, row.note) == (0.2801, "not comparable", "Why.")
    (row,) = mean_row("ideal, FpMW", ETA, walks(0.027, 0.028))
    assert row.reproduces is None


def test_units_of_rows():
    (row,) = mean_row("here", PITCH, walks(1.0, pitch_rms_rad=math.pi / 180))
    assert (row.quantity, row.ours) == ("here: pitch rms (°)", pytest.approx(1.0))


def test_walks_that_do_not_arrive_have_no_time():
    arrived, lost = walks(0.1, completion_time_s=62.0), walks(0.1)
    (row,) = mean_row("here", TIME, arrived + lost)
    assert (row.ours, row.note) == (62.0, "Of 1 of 2 walks.")
    assert mean_row("here", TIME, lost) == []
    assert ratio_row("ratio", TIME, lost, arrived) == []
    (row,) = ratio_row("ratio", TIME, arrived + lost, arrived + arrived)
    assert row.note == "Of 1 seeds."


@pytest.mark.parametrize(
    ("parts", "reproduces", "note"),
    [
        ((0.30, 0.31, 0.32), "yes", ""),
        ((0.10, 0.11, 0.12), "no", "Ours is not above 1."),
        ((0.15, 0.25, 0.50), "undecided", ""),
        # Three ten-thousandths more in every seed are sure, and no reproduction of 4.7 %.
        ((0.20006, 0.20006, 0.20006), "no", "By less than a tenth of what is printed, 1.005."),
    ],
)
def test_an_order_reproduces_when_the_whole_interval_has_it(parts, reproduces, note):
    (row,) = ratio_row("η, FpM / FpMW (1)", ETA, walks(*parts), walks(0.2, 0.2, 0.2), 0.2933 / 0.2801)
    assert (row.reproduces, row.note) == (reproduces, note)
    assert row.paper == pytest.approx(1.0471, abs=1e-4)


def test_a_claim_in_words_has_no_printed_number():
    (row,) = ratio_row("6 cm / 3 cm (1)", ETA, walks(0.3, 0.31), walks(0.2, 0.2), is_claimed=True)
    assert (row.paper, row.reproduces) == (None, "yes")


def test_an_order_of_medians_alone_is_not_judged():
    walked = dict(zip(table_5.NAMES, (walks(0.2, 0.4), walks(0.2001, 0.4001), walks(0.5, 0.6)), strict=True))
    row = table_5._order_row("ideal", walked)
    assert (row.ours, row.paper, row.reproduces) == (1.0, None, None)


def test_falls_are_counted():
    row = fall_row("here", walks(0.1, 0.2) + walks(0.3, fallen=1.0))
    assert (row.ours, row.note) == (pytest.approx(1 / 3), "1 of 3.")
