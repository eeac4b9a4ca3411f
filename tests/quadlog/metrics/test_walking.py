"""Drifts and gaits against what they were made of, torques by numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.metrics.summary import metrics_of
from quadlog.metrics.walking import (
    JOINTS,
    BodySeries,
    body_samples,
    clearance_samples,
    drift_metrics,
    gait,
    ground_speed,
    stance_where,
    torque_rows,
)

REST, PERIOD, CYCLES, PERIOD_S = 100, 50, 30, 1.0
SAMPLES = REST + PERIOD * CYCLES + 1
T_S = (np.arange(SAMPLES) - REST) * PERIOD_S / PERIOD


def drift(position_m, rpy_rad, rest: int = REST) -> dict[str, float]:
    found = drift_metrics(position_m, rpy_rad, np.zeros(SAMPLES, bool), rest, PERIOD, PERIOD_S)
    return {name: metric.value for name, metric in found.items()}


@given(st.floats(-50, 50), st.floats(0, 20), st.floats(0, 6.3), st.floats(-1, 1), st.floats(-1, 1))
def test_a_trots_drifts_are_those_of_its_cycles_whatever_swings_within(rate, sway, phase, x_mps, y_mps):
    """From the first step on: what moves while the robot rests does not count."""
    yaw_deg = rate * T_S + sway * np.sin(2 * np.pi * T_S / PERIOD_S + phase)
    position_m = np.where(T_S < 0, 7.0, 0.0)[:, None] + T_S[:, None] * [x_mps, y_mps, 0.0]
    found = drift(position_m, np.radians(np.column_stack([0 * T_S, 0 * T_S, yaw_deg])))
    assert found["yaw_rate_degps"] == pytest.approx(rate, abs=1e-9)
    assert [found["forward_m"], found["lateral_drift_m"]] == pytest.approx([30 * x_mps, 30 * y_mps], abs=1e-9)


def test_a_collision_is_counted_once_while_it_lasts():
    clearance_m = np.array([-0.1, 0.2, 0.0, -0.2, 0.3, np.inf, np.nan, -0.1])
    distance_m = np.array([1.0, np.nan, 2.0, *[np.nan] * 5])
    metrics = metrics_of(clearance_samples(np.arange(8), clearance_m, distance_m))
    assert metrics["clearance_min_m"].value == -0.2
    assert (metrics["collisions"].value, metrics["collisions"].n) == (3, 7)
    assert (metrics["following_distance_mean_m"].value, metrics["following_distance_mean_m"].n) == (1.5, 2)


START_NS = 1_700_000_000 * 10**9


def walk(n: int, step_s: float = 0.005, speed_mps: float = 0.5) -> BodySeries:
    """A body that stands on all feet while it moves, with torques of 1 to 12 N·m."""
    return BodySeries(
        t_ns=START_NS + np.rint(np.arange(n) * step_s * 1e9).astype(np.int64),
        speed_mps=np.full(n, speed_mps),
        torque_nm=np.tile(np.arange(1.0, 13.0), (n, 1)),
        stance=np.ones((n, 4)),
        power_w=np.full(n, 60.0),
        pitch_rad=np.zeros(n),
    )


def trotting(period_s: float, duty: float, step_s: float, seconds: float = 12.0) -> BodySeries:
    """Each foot stands for the share `duty` of a period, the diagonals half a period apart."""
    still = walk(round(seconds / step_s), step_s)
    t_s = (still.t_ns - START_NS) * 1e-9
    phase = (t_s[:, None] / period_s + [0.0, 0.5, 0.5, 0.0]) % 1.0
    return replace(still, stance=stance_where(still.t_ns, np.where(phase < duty, 0.9, 0.1), 0.5))


@given(period_s=st.floats(0.3, 1.2), duty=st.floats(0.35, 0.75), step_s=st.sampled_from([0.001, 0.002, 0.005, 0.02]))
def test_duty_factor_and_stride_frequency_of_a_gait_known_by_construction(period_s, duty, step_s):
    body = trotting(period_s, duty, step_s)
    walked, metrics = gait(body, 10.0), metrics_of(body_samples(body))
    duties = [walked[f"duty_factor_{foot}"] for foot in range(4)]
    # A touch-down is known to a row, and the 12 s hold no whole number of periods.
    assert walked["stride_frequency_hz"] == pytest.approx(1 / period_s, rel=2 * step_s / period_s)
    assert duties == pytest.approx(np.full(4, duty), abs=period_s / 12 + 2 * step_s / period_s)
    assert metrics["stride_frequency_hz"].value == pytest.approx(walked["stride_frequency_hz"])
    assert metrics["duty_factor"].value == pytest.approx(np.mean(duties))


def test_strides_over_a_gap_too_long_or_of_a_body_that_rests_are_none():
    body = trotting(0.5, 0.5, 0.005)
    t_ns = body.t_ns + np.where(np.arange(len(body.t_ns)) < 1000, 0, 10**9)
    assert gait(replace(body, t_ns=t_ns), 10.0)["stride_frequency_hz"] == pytest.approx(2.0, rel=1e-6)
    assert np.isnan(gait(trotting(2.5, 0.5, 0.005), 10.0)["stride_frequency_hz"])
    rests = gait(replace(body, speed_mps=np.zeros(len(t_ns))), 10.0)
    assert (rests.pop("n"), np.isnan(list(rests.values())).all()) == (0, True)


@given(seed=st.integers(0, 1000), share=st.floats(0.0, 0.4))
def test_torques_of_each_joint_and_phase_are_those_of_numpy(seed, share):
    rng = np.random.default_rng(seed)
    torque_nm = rng.normal(0, 10, (300, 12))
    torque_nm[rng.random(torque_nm.shape) < share] = np.nan
    stance = (rng.random((300, 4)) < 0.5).astype(float)
    body = replace(walk(300), torque_nm=torque_nm, stance=stance)
    rows = torque_rows(body)
    assert len(rows) == 36
    for row in rows:
        joint = JOINTS.index(row["joint"])
        inside = {"stance": stance[:, joint // 3] == 1, "swing": stance[:, joint // 3] == 0, "all": np.full(300, True)}
        values = torque_nm[inside[row["phase"]], joint]
        assert row["torque_rms_nm"] == pytest.approx(np.sqrt(np.nanmean(values**2)))
        assert row["torque_peak_nm"] == np.nanmax(np.abs(values))
        assert (row["n"], row["n_unknown"]) == (np.isfinite(values).sum(), np.isnan(values).sum())
    rms, peak = (metrics_of(body_samples(body))[name] for name in ("torque_rms_nm", "torque_max_nm"))
    assert rms.value == pytest.approx(np.sqrt(np.nanmean(torque_nm**2)))
    assert (rms.n, peak.value) == (np.isfinite(torque_nm).any(axis=1).sum(), np.nanmax(np.abs(torque_nm)))


def test_speed_is_that_over_a_second_and_unknown_beside_gaps():
    places_ns = START_NS + np.arange(0, 20_000, 10) * 10**6
    s = (places_ns - START_NS) * 1e-9
    sways_m = np.column_stack([0.6 * s, 0.02 * np.sin(2 * np.pi * 2 * s)])
    t_ns = START_NS + np.arange(500, 19_500, 7) * 10**6
    np.testing.assert_allclose(ground_speed(t_ns, places_ns, sways_m), 0.6, atol=0.01)
    gap = (s < 8) | (s > 10)
    unknown = np.isnan(ground_speed(t_ns, places_ns[gap], sways_m[gap]))
    t_s = (t_ns - START_NS) * 1e-9
    # The last place before the gap is at 7.99 s, the first after it at 10.01 s.
    np.testing.assert_array_equal(unknown, (t_s > 7.49) & (t_s < 10.51))
