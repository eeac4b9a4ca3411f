from __future__ import annotations

import pytest

from quadlog.metrics.walking import effort_metrics

WALK = {
    "energy_j": 500.0,
    "distance_m": 4.0,
    "torque_max_nm": 20.0,
    "saturation_share": 0.25,
    "pitch_rms_rad": 0.01,
    "height_rms_m": 0.002,
}


def test_cost_of_transport_is_energy_per_weight_and_way():
    metrics = effort_metrics(10.0, 100, **WALK)
    assert metrics["cost_of_transport"].value == pytest.approx(500 / (10 * 9.81 * 4))
    assert metrics["torque_saturation_share"].n == 1200
    assert (metrics["torque_max_nm"].value, metrics["torque_max_nm"].unit) == (20.0, "N·m")
    assert (metrics["pitch_rms_rad"].value, metrics["height_rms_m"].value) == (0.01, 0.002)


def test_what_does_not_apply_is_absent():
    assert effort_metrics(10.0, 0, **WALK) == {}
    assert "cost_of_transport" not in effort_metrics(10.0, 100, **WALK | {"distance_m": 0.0})
