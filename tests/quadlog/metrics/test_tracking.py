from __future__ import annotations

import statistics

import numpy as np
import pytest

from quadlog.metrics.summary import metrics_of
from quadlog.metrics.walking import clearance_samples, tracking_metrics


def walk(n=50, **columns):
    rng = np.random.default_rng(0)
    signed = rng.normal(0, 0.1, n)
    defaults = {
        "t_ns": np.arange(n) * 20_000_000,
        "error_m": np.abs(signed),
        "cross_track_m": signed,
        "time_error_m": rng.uniform(0, 1, n),
        "heading_error_rad": rng.normal(0, 0.2, n),
    }
    return defaults | columns


def test_mean_and_sample_deviation_against_the_standard_library():
    tracked = walk()
    metrics = tracking_metrics(tracked)
    for mean, deviation, column in (
        ("eta_m", "sigma_m", tracked["error_m"]),
        ("eta_time_m", "sigma_time_m", tracked["time_error_m"]),
    ):
        assert metrics[mean].value == pytest.approx(statistics.fmean(column))
        assert metrics[deviation].value == pytest.approx(statistics.stdev(column))
        assert (metrics[mean].n, metrics[mean].unit) == (50, "m")
    # The printed form of eq. 47, N being N_e.
    eta, n = metrics["eta_m"].value, 50
    printed = np.sqrt((np.sum(tracked["error_m"] ** 2) - eta**2 * n) / (n - 1))
    assert metrics["sigma_m"].value == pytest.approx(printed)
    assert metrics["cross_track_rmse_m"].value == pytest.approx(np.sqrt(np.mean(tracked["cross_track_m"] ** 2)))
    assert metrics["heading_rmse_rad"].unit == "rad"
    assert metrics["max_error_m"].value == tracked["error_m"].max()


def test_what_does_not_apply_is_absent():
    metrics = tracking_metrics(walk())
    assert not {"completion_time_s", "fallen"} & set(metrics)
    nothing = np.full(4, np.nan)
    empty = tracking_metrics(
        walk(4, error_m=nothing, cross_track_m=nothing, time_error_m=nothing, heading_error_rad=nothing)
    )
    assert empty == {}
    single = tracking_metrics(walk(1))
    assert "eta_m" in single
    assert "sigma_m" not in single


def test_completion_and_falls():
    metrics = tracking_metrics(walk(3, fallen=np.array([False, True, True])), completed_ns=1_500_000_000)
    assert metrics["completion_time_s"].value == 1.5
    assert metrics["fallen"].value == 1.0


def clearances(clearance_m):
    distance_m = np.array([1.0, np.nan, 2.0, *[np.nan] * len(clearance_m)])[: len(clearance_m)]
    return metrics_of(clearance_samples(np.arange(len(clearance_m)), np.array(clearance_m), distance_m))


def test_a_collision_is_counted_once_while_it_lasts():
    metrics = clearances([-0.1, 0.2, 0.0, -0.2, 0.3, np.inf, np.nan, -0.1])
    assert metrics["clearance_min_m"].value == -0.2
    assert (metrics["collisions"].value, metrics["collisions"].n) == (3, 7)
    assert (metrics["following_distance_mean_m"].value, metrics["following_distance_mean_m"].n) == (1.5, 2)
