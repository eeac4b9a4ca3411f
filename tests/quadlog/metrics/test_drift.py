from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import linregress

from quadlog.metrics.walking import drift_metrics

REST, PERIOD, CYCLES, PERIOD_S = 100, 50, 30, 1.0
SAMPLES = REST + PERIOD * CYCLES + 1
T_S = (np.arange(SAMPLES) - REST) * PERIOD_S / PERIOD


def _value(name: str, position_m=None, rpy_rad=None, rest=REST) -> float:
    still = np.zeros((SAMPLES, 3))
    turns = still if rpy_rad is None else rpy_rad
    fallen = np.zeros(SAMPLES, bool)
    return drift_metrics(still if position_m is None else position_m, turns, fallen, rest, PERIOD, PERIOD_S)[name].value


def test_the_line_is_that_of_the_cycles_means():
    rpy_rad = np.random.default_rng(2).normal(0, 0.3, (SAMPLES, 3))
    cycles = [np.degrees(rpy_rad[REST + PERIOD * k : REST + PERIOD * (k + 1), 2]).mean() for k in range(CYCLES)]
    fitted = linregress(np.arange(CYCLES) * PERIOD_S, cycles).slope
    assert _value("yaw_rate_degps", rpy_rad=rpy_rad) == pytest.approx(fitted)


def _turning(rate_degps: float, sway_deg: float = 0.0, phase: float = 0.0):
    yaw_deg = rate_degps * T_S + sway_deg * np.sin(2 * np.pi * T_S / PERIOD_S + phase)
    return np.radians(np.column_stack([0 * T_S, 0 * T_S, yaw_deg]))


@given(st.floats(-50, 50), st.floats(0, 20), st.floats(0, 6.3))
def test_the_yaw_rate_is_the_slope_whatever_swings_within_a_cycle(rate, sway, phase):
    assert _value("yaw_rate_degps", rpy_rad=_turning(rate, sway, phase)) == pytest.approx(rate, abs=1e-9)


def test_drift_and_way_are_from_the_first_step_on_and_have_their_signs():
    moved = np.where(T_S < 0, 7.0, 0.0) + 0.1 * T_S
    position_m = np.column_stack([moved, -2 * moved, 0 * moved])
    assert _value("forward_m", position_m) == pytest.approx(3.0)
    assert _value("lateral_drift_m", position_m) == pytest.approx(-6.0)


@pytest.mark.parametrize("rest", [REST + 1, SAMPLES - 1, SAMPLES - 1 - PERIOD])
def test_what_is_no_two_whole_cycles_is_refused(rest):
    with pytest.raises(ValueError, match="whole cycles"):
        _value("forward_m", rest=rest)
