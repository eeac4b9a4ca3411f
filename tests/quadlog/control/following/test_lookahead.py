from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.following.lookahead import CORRECTED, PRINTED, FuzzyLookahead, infer
from quadlog.control.settings import FuzzySettings, PursuitSettings


def look(l0_m=2.0, **fuzzy) -> FuzzyLookahead:
    return FuzzyLookahead(PursuitSettings(lookahead_m=l0_m, fuzzy=FuzzySettings(**fuzzy)))


@given(errors=st.lists(st.floats(-2, 2), min_size=1, max_size=6), speed=st.floats(0, 1.2), signed=st.booleans())
def test_equations_17_and_18(errors, speed, signed):
    """Against infer on the errors and their differences."""
    weights = {"lambda_v_s2_per_m": 0.7, "lambda_w_s": 0.4, "gain_e_per_m": 2.0, "gain_ec_s_per_m": 0.1}
    control = look(1.8, **weights, signed=signed)
    last = None
    for error in errors:
        e = error if signed else abs(error)
        rate = 0.0 if last is None else (e - last) / 0.02
        last = e
        found = control.step(error, 0.02, speed)
        assert (found.k_v, found.k_w) == pytest.approx(infer(2.0 * e, 0.1 * rate, CORRECTED))
        exact = 1.8 + 0.7 * found.k_v * speed**2 + 0.4 * found.k_w * speed
        assert found.l_m == pytest.approx(min(max(exact, 0.5), 5.0))


def test_the_papers_setting():
    assert look(tables="printed").step(0.0, 0.02, 0.5) == pytest.approx((1.5, 0.0, -1.0))
    # Without error l_0 is the look-ahead, by the mended rules, which are the default.
    assert look().step(0.0, 0.02, 0.5) == pytest.approx((2.0, 0.0, 0.0))
    # Its limits do not bite: (e, ec) over the whole universe, each a constant slope away from the first error.
    control = look(tables="printed")
    for speed in (0.5, 0.6):
        reached = []
        for e in range(4):
            for ec in range(-3, 4):
                control.reset()
                control.step(e - 0.5 * ec if e - 0.5 * ec > 0 else 0.0, 0.5, speed)
                reached.append(control.step(e, 0.5, speed).l_m)
        assert control.settings.l_min_m < min(reached)
        assert max(reached) < control.settings.l_max_m


def test_unsigned_treats_left_and_right_alike_and_signed_does_not():
    for signed in (False, True):
        control = {"gain_e_per_m": 10.0, "signed": signed}
        left = [look(**control).step(error, 0.02, 0.5).l_m for error in (0.1, 0.15, 0.25)]
        right = [look(**control).step(-error, 0.02, 0.5).l_m for error in (0.1, 0.15, 0.25)]
        assert (left == right) is not signed


def test_the_rates_filter_against_its_differential_equation():
    """tau r' + r = de/dt on a ramp: r = slope (1 - exp(-t / tau)), whatever the step."""
    for dt_s in (0.02, 0.1):
        control = look(tables="printed", gain_e_per_m=0.0, ec_filter_s=0.4, signed=True)
        for k in range(21):
            found = control.step(1.5 * k * dt_s, dt_s, 0.5)
            rate = 1.5 * (1 - math.exp(-k * dt_s / 0.4))
            assert (found.k_v, found.k_w) == pytest.approx(infer(0.0, rate, PRINTED))
