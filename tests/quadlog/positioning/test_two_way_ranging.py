"""Two-way ranging by exact rational arithmetic, and the errors that either form has."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from quadlog.positioning.two_way_ranging import (
    LIGHT_MPS,
    TwoWayTimes,
    averaged_range_m,
    general_range_m,
    measured_times,
)

FAST, SLOW = 20e-6, -20e-6
EQUAL, UNEQUAL = (3e-4, 3e-4), (3e-4, 1e-3)


@pytest.mark.parametrize("replies_s", [EQUAL, UNEQUAL])
@pytest.mark.parametrize("range_m", [general_range_m, averaged_range_m])
def test_perfect_clocks_give_the_distance(range_m, replies_s):
    distance_m = np.array([0.0, 0.3, 12.5, 50.0])
    assert range_m(measured_times(distance_m, replies_s, (0.0, 0.0))) == pytest.approx(distance_m, abs=1e-6)


@pytest.mark.parametrize("errors", [(FAST, SLOW), (SLOW, SLOW), (FAST, FAST)])
@pytest.mark.parametrize("replies_s", [EQUAL, UNEQUAL])
def test_the_general_form_errs_by_half_of_the_clocks_errors_whatever_the_replies(replies_s, errors):
    distance_m = np.array([1.0, 10.0, 50.0])
    off_m = general_range_m(measured_times(distance_m, replies_s, errors)) - distance_m
    assert off_m == pytest.approx(distance_m * sum(errors) / 2, abs=2e-6)
    assert np.abs(off_m).max() <= 1.01e-3


@pytest.mark.parametrize(("replies_s", "off_m"), [(EQUAL, 0.0), (UNEQUAL, 2.1)])
def test_the_mean_of_four_errs_by_the_difference_of_the_replies(replies_s, off_m):
    found_m = averaged_range_m(measured_times(50.0, replies_s, (FAST, SLOW)))
    predicted_m = LIGHT_MPS * abs(replies_s[0] - replies_s[1]) * (FAST - SLOW) / 4
    assert abs(found_m - 50.0) == pytest.approx(predicted_m, abs=1e-6)
    assert predicted_m == pytest.approx(off_m, abs=0.01)


def test_rounding_costs_no_micrometre():
    times = measured_times(50.0, UNEQUAL, (FAST, SLOW))
    ra, da, rb, db = (
        Fraction(float(each)) for each in (times.round_a_s, times.reply_a_s, times.round_b_s, times.reply_b_s)
    )
    exact_m = Fraction(LIGHT_MPS) * (ra * rb - da * db) / (ra + da + rb + db)
    assert float(general_range_m(times)) == pytest.approx(float(exact_m), abs=1e-7)
    assert general_range_m(TwoWayTimes(2e-7, 0.0, 2e-7, 0.0)) == pytest.approx(LIGHT_MPS * 1e-7)
