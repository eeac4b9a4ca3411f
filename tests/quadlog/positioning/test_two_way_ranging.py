"""Two-way ranging by exact rational arithmetic, and the errors that either form has."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from quadlog.positioning.two_way_ranging import LIGHT_MPS, averaged_range_m, general_range_m, measured_times

FAST, SLOW = 20e-6, -20e-6
EQUAL, UNEQUAL = (3e-4, 3e-4), (3e-4, 1e-3)
FAR_M = np.array([0.0, 1.0, 12.5, 50.0])


@pytest.mark.parametrize("errors", [(0.0, 0.0), (FAST, SLOW), (SLOW, SLOW), (FAST, FAST)])
@pytest.mark.parametrize("replies_s", [EQUAL, UNEQUAL])
def test_the_general_form_errs_by_half_of_the_clocks_errors_and_the_mean_by_the_replies_difference(replies_s, errors):
    times_s = measured_times(FAR_M, replies_s, errors)
    np.testing.assert_allclose(general_range_m(times_s) - FAR_M, FAR_M * sum(errors) / 2, atol=2e-6)
    off_m = LIGHT_MPS * (replies_s[1] - replies_s[0]) * (errors[0] - errors[1]) / 4
    np.testing.assert_allclose(averaged_range_m(times_s) - FAR_M, FAR_M * sum(errors) / 2 + off_m, atol=2e-6)
    assert abs(off_m) == pytest.approx(2.1 if replies_s is UNEQUAL and errors == (FAST, SLOW) else 0.0, abs=0.01)
    for k in range(len(FAR_M)):
        ra, da, rb, db = (Fraction(float(each)) for each in times_s[:, k])
        exact_m = Fraction(LIGHT_MPS) * (ra * rb - da * db) / (ra + da + rb + db)
        assert general_range_m(times_s)[k] == pytest.approx(float(exact_m), abs=1e-7)
