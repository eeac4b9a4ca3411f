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


def test_time_is_in_cycles_of_the_period_given():
    rate = drift_metrics(_walk(rpy_rad=_turning(3.0)), 2 * PERIOD_S)["yaw_rate_degps"].value
    assert rate == pytest.approx(1.5)


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


def test_a_line_through_single_samples_would_tilt():
    """Why the mean of each cycle is taken: 1 degree of sway is as much as the drift that is looked for."""
    yaw_deg = np.degrees(_turning(0.0, 1.0)[REST:-1, 2])
    slope = np.polyfit(T_S[REST:-1], yaw_deg, 1)[0]
    assert abs(slope) > 1e-3
    assert _value(_walk(rpy_rad=_turning(0.0, 1.0)), "yaw_rate_degps") == pytest.approx(0, abs=1e-12)


def test_turning_past_half_a_turn_goes_on():
    walk = _walk(rpy_rad=np.angle(np.exp(1j * _turning(30.0))))
    assert _value(walk, "yaw_rate_degps") == pytest.approx(30.0)
    assert _value(walk, "yaw_range_deg") == pytest.approx(900.0)


def test_drift_and_way_are_from_the_first_step_on_and_have_their_signs():
    moved = np.where(T_S < 0, 7.0, 0.0) + 0.1 * T_S
    walk = _walk(x_m=moved, y_m=-2 * moved)
    assert _value(walk, "forward_m") == pytest.approx(3.0)
    assert _value(walk, "lateral_drift_m") == pytest.approx(-6.0)


def test_ranges_are_peak_to_peak_of_the_trot():
    angles = np.radians(np.column_stack([5 * np.sin(T_S), 2 * np.cos(T_S) + 1, 0 * T_S]))
    angles[:REST] = 1.0
    walk = _walk(rpy_rad=angles)
    assert _value(walk, "roll_range_deg") == pytest.approx(10, abs=0.01)
    assert _value(walk, "pitch_range_deg") == pytest.approx(4, abs=0.01)
    assert _value(walk, "yaw_range_deg") == 0


def test_a_fall_is_told():
    fallen = np.zeros(SAMPLES, bool)
    assert _value(_walk(fallen=fallen), "fallen") == 0
    fallen[-1] = True
    assert _value(_walk(fallen=fallen), "fallen") == 1


def test_units_are_told():
    units = {name: metric.unit for name, metric in drift_metrics(_walk(), PERIOD_S).items()}
    assert units == {
        "lateral_drift_m": "m",
        "yaw_rate_degps": "deg/s",
        "forward_m": "m",
        "fallen": "",
        "roll_range_deg": "deg",
        "pitch_range_deg": "deg",
        "yaw_range_deg": "deg",
    }


@pytest.mark.parametrize("rest", [REST + 1, SAMPLES - 1, SAMPLES - 1 - PERIOD])
def test_what_is_no_two_whole_cycles_is_refused(rest):
    with pytest.raises(ValueError, match="whole cycles"):
        drift_metrics(_walk(rest=rest), PERIOD_S)
