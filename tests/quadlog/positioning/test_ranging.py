from __future__ import annotations

import doctest
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.positioning import two_way_ranging as ranging
from quadlog.positioning.two_way_ranging import (
    COUNTER_BITS,
    SPEED_OF_LIGHT_IN_AIR_MPS,
    TICK_S,
    TwoWayIntervals,
    double_sided_range,
    intervals_from_ticks,
    single_sided_range,
    symmetric_range,
)

C = SPEED_OF_LIGHT_IN_AIR_MPS
ppm = st.floats(-20.0, 20.0)
reply_s = st.floats(1e-6, 1.0)
distance_m = st.floats(0.0, 50.0)


def exchange(distance, reply_a, reply_b, drift_a_ppm=0.0, drift_b_ppm=0.0) -> TwoWayIntervals:
    """What two drifting clocks show of one exchange, made from its definition: out, wait, back, wait, out."""
    flight = np.asarray(distance) / C
    a, b = 1 + np.asarray(drift_a_ppm) * 1e-6, 1 + np.asarray(drift_b_ppm) * 1e-6
    times = ((2 * flight + reply_b) * a, reply_b * b, (2 * flight + reply_a) * b, reply_a * a)
    return TwoWayIntervals(*np.broadcast_arrays(*(np.atleast_1d(each) for each in times)))


@given(distance_m, reply_s, reply_s, ppm, ppm)
def test_the_general_form_errs_by_the_mean_drift_whatever_the_replies(distance, reply_a, reply_b, drift_a, drift_b):
    got = double_sided_range(exchange(distance, reply_a, reply_b, drift_a, drift_b))
    error_m = got.range_m[0] - distance
    assert error_m == pytest.approx(distance * (drift_a + drift_b) / 2 * 1e-6, abs=1e-6)
    assert abs(error_m) <= 1.001e-3


@given(distance_m, reply_s, reply_s, ppm, ppm)
def test_the_symmetric_form_errs_by_the_difference_of_the_replies(distance, reply_a, reply_b, drift_a, drift_b):
    got = symmetric_range(exchange(distance, reply_a, reply_b, drift_a, drift_b))
    from_drift_m = C * (reply_b - reply_a) * (drift_a - drift_b) * 1e-6 / 4
    assert got.range_m[0] - distance == pytest.approx(from_drift_m, abs=1.01e-3)


@given(distance_m, reply_s, ppm, ppm)
def test_the_single_sided_form_errs_by_the_whole_reply(distance, reply_b, drift_a, drift_b):
    times = exchange(distance, 1e-3, reply_b, drift_a, drift_b)
    got = single_sided_range(times.round_a_s, times.reply_b_s)
    from_drift_m = C * reply_b * (drift_a - drift_b) * 1e-6 / 2
    assert got.range_m[0] - distance == pytest.approx(from_drift_m, abs=1.01e-3)


def test_the_figures_of_the_module():
    """Replies of 300 and 1000 us between clocks at +-20 ppm, 50 m apart."""
    times = exchange(50.0, 1000e-6, 300e-6, -20, 20)
    assert double_sided_range(times).range_m[0] == pytest.approx(50.0, abs=1e-6)
    assert symmetric_range(times).range_m[0] - 50 == pytest.approx(2.1, abs=0.01)
    assert single_sided_range(times.round_a_s, times.reply_b_s).range_m[0] - 50 == pytest.approx(-1.8, abs=0.01)
    both_fast = double_sided_range(exchange(50.0, 1000e-6, 300e-6, 20, 20)).range_m[0] - 50
    assert both_fast == pytest.approx(1e-3, rel=1e-6)


def test_equal_replies_make_the_symmetric_form_as_good_as_the_general_one():
    times = exchange(np.linspace(1, 50, 20), 300e-6, 300e-6, 20, -13)
    np.testing.assert_allclose(symmetric_range(times).range_m, double_sided_range(times).range_m, atol=1e-5)


@given(st.tuples(*[st.integers(1, 2**39)] * 4))
def test_the_general_form_against_exact_fractions(ticks):
    ra, db, rb, da = ticks
    exact = Fraction(ra * rb - da * db, ra + rb + da + db)
    got = double_sided_range(TwoWayIntervals(*(np.array([each * TICK_S]) for each in ticks)))
    assert got.range_m[0] == pytest.approx(C * TICK_S * float(exact), rel=1e-9, abs=1e-14 * C * TICK_S * max(ticks))


@given(st.integers(0, 2**40 - 1), st.integers(0, 2**40 - 1), st.sampled_from([32, 40]))
def test_a_counter_that_starts_again_changes_nothing(start_a, start_b, bits):
    """Six stamps counted without end, and what is left of them in a counter."""
    flight, reply_a, reply_b = 2132, 63_897_600, 19_169_280
    poll_sent, poll_received = start_a, start_b
    response_sent, response_received = start_b + reply_b, start_a + reply_b + 2 * flight
    final_sent = response_received + reply_a
    final_received = response_sent + 2 * flight + reply_a
    stamps = (poll_sent, poll_received, response_sent, response_received, final_sent, final_received)
    times = intervals_from_ticks(*([stamp % 2**bits] for stamp in stamps), counter_bits=bits)
    got = double_sided_range(times)
    assert got.measured.all()
    assert got.range_m[0] == pytest.approx(flight * TICK_S * C, abs=1e-6)


def test_stamps_out_of_order_are_no_range_of_half_the_earth():
    times = intervals_from_ticks([100], [900], [800], [100 + 2 * 10**6], [3 * 10**6], [4 * 10**6])
    assert times.reply_b_s[0] == pytest.approx(-100 * TICK_S)
    got = double_sided_range(times)
    assert np.isnan(got.range_m).all()
    assert (got.not_finite, got.not_positive) == (0, 1)


@pytest.mark.parametrize("form", [double_sided_range, symmetric_range])
def test_times_that_cannot_be_are_counted_by_cause(form):
    times = exchange(np.full(8, 5.0), 1e-3, 3e-4)
    columns = [np.array(each) for each in (times.round_a_s, times.reply_b_s, times.round_b_s, times.reply_a_s)]
    columns[0][1] = np.nan
    columns[1][2] = np.inf
    columns[2][3] = 0.0
    columns[3][4] = -1e-3
    columns[0][5], columns[1][5] = np.nan, -1.0
    got = form(TwoWayIntervals(*columns))
    np.testing.assert_array_equal(got.measured, [True, False, False, False, False, False, True, True])
    np.testing.assert_array_equal(np.isnan(got.range_m), ~got.measured)
    assert (got.not_finite, got.not_positive) == (3, 2)


def test_times_that_overflow_are_counted_too():
    got = double_sided_range(TwoWayIntervals(*np.full((4, 1), 1e200)))
    assert (got.measured.any(), got.not_finite) == (False, 1)


def test_radios_side_by_side_may_come_out_below_zero():
    got = single_sided_range([3e-4 - 1e-10], [3e-4])
    assert got.measured.all()
    assert got.range_m[0] == pytest.approx(-0.015, abs=1e-4)


def test_no_exchanges_give_no_ranges():
    got = double_sided_range(TwoWayIntervals(*np.empty((4, 0))))
    assert (len(got.range_m), got.not_finite, got.not_positive) == (0, 0, 0)


def test_stamps_that_are_no_counters_are_refused():
    seconds = [1.7e9]
    with pytest.raises(TypeError, match="float64"):
        intervals_from_ticks(seconds, seconds, seconds, seconds, seconds, seconds)


def test_a_counter_lasts_as_long_as_the_chips_manual_says():
    counter_s = 2**COUNTER_BITS * TICK_S
    assert counter_s == pytest.approx(17.2, abs=0.01)
    tick_ps = 1e12 * TICK_S
    assert tick_ps == pytest.approx(15.65, rel=1e-4)
    late_m = 50 * (1 - SPEED_OF_LIGHT_IN_AIR_MPS / 299_792_458)
    assert late_m == pytest.approx(0.015, abs=1e-4)


def test_the_example_of_the_module():
    assert doctest.testmod(ranging) == (0, 3)
