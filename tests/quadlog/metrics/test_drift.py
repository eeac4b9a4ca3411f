from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import linregress

from quadlog.metrics.walking import TrottedWalk, drift_metrics

REST, PERIOD, CYCLES, PERIOD_S = 100, 50, 30, 1.0
SAMPLES = REST + PERIOD * CYCLES + 1
T_S = (np.arange(SAMPLES) - REST) * PERIOD_S / PERIOD


def _walk(x_m=None, y_m=None, rpy_rad=None, fallen=None, rest=REST) -> TrottedWalk:
    nothing = np.zeros(SAMPLES)
    return TrottedWalk(
        nothing if x_m is None else x_m,
        nothing if y_m is None else y_m,
        np.zeros((SAMPLES, 3)) if rpy_rad is None else rpy_rad,
        nothing.astype(bool) if fallen is None else fallen,
        rest,
        PERIOD,
    )


def _value(walk: TrottedWalk, name: str) -> float:
    return drift_metrics(walk, PERIOD_S)[name].value


def test_the_line_is_that_of_the_cycles_means():
    rpy_rad = np.random.default_rng(2).normal(0, 0.3, (SAMPLES, 3))
    cycles = [np.degrees(rpy_rad[REST + PERIOD * k : REST + PERIOD * (k + 1), 2]).mean() for k in range(CYCLES)]
    fitted = linregress(np.arange(CYCLES) * PERIOD_S, cycles).slope
    assert _value(_walk(rpy_rad=rpy_rad), "yaw_rate_degps") == pytest.approx(fitted)


def _turning(rate_degps: float, sway_deg: float = 0.0, phase: float = 0.0):
    yaw_deg = rate_degps * T_S + sway_deg * np.sin(2 * np.pi * T_S / PERIOD_S + phase)
    return np.radians(np.column_stack([0 * T_S, 0 * T_S, yaw_deg]))


@given(st.floats(-50, 50), st.floats(0, 20), st.floats(0, 6.3))
def test_the_yaw_rate_is_the_slope_whatever_swings_within_a_cycle(rate, sway, phase):
    assert _value(_walk(rpy_rad=_turning(rate, sway, phase)), "yaw_rate_degps") == pytest.approx(rate, abs=1e-9)


def test_drift_and_way_are_from_the_first_step_on_and_have_their_signs():
    moved = np.where(T_S < 0, 7.0, 0.0) + 0.1 * T_S
    walk = _walk(x_m=moved, y_m=-2 * moved)
    assert _value(walk, "forward_m") == pytest.approx(3.0)
    assert _value(walk, "lateral_drift_m") == pytest.approx(-6.0)


@pytest.mark.parametrize("rest", [REST + 1, SAMPLES - 1, SAMPLES - 1 - PERIOD])
def test_what_is_no_two_whole_cycles_is_refused(rest):
    with pytest.raises(ValueError, match="whole cycles"):
        drift_metrics(_walk(rest=rest), PERIOD_S)
