from __future__ import annotations

import math

import numpy as np

from quadlog.simulation.robot.disturbances import DISTURBED, HEADING_ARM_M, NONE, Disturbances
from quadlog.simulation.settings import DisturbanceSettings


def _disturbances(settings=DISTURBED, seed=0):
    return Disturbances(settings, np.random.default_rng(seed))


def test_without_settings_there_are_no_disturbances():
    calm = _disturbances(NONE)
    pose = np.array([1.0, 2.0, 3.0])
    assert calm.measured(0.0, pose) is pose
    assert all(calm.push_at(t_s, pose) is None for t_s in np.arange(0, 10, 0.002))
    assert calm.velocity_bias_mps.tolist() == [0, 0, 0]


def test_pushes_are_lateral_and_periodic():
    pushed = _disturbances()
    yaw_rad = 0.7
    times = np.arange(0, 20, 0.002)
    forces = [pushed.push_at(t_s, np.array([0.1, 0.2, yaw_rad])) for t_s in times]
    at = np.array([force is not None for force in forces])
    begins = times[1:][at[1:] & ~at[:-1]]
    np.testing.assert_allclose(begins, np.arange(2, 20, 2), atol=2e-3)
    assert abs(at.sum() * 0.002 - 9 * 0.1) < 9 * 2e-3
    left = np.array([-math.sin(yaw_rad), math.cos(yaw_rad), 0.0])
    sides = {round(float(force @ left), 9) for force in forces if force is not None}
    assert sides == {60.0, -60.0}
    assert all(abs(np.linalg.norm(force) - 60) < 1e-9 for force in forces if force is not None)


def test_pose_lag_and_noise_are_those_of_the_settings():
    late = _disturbances(DisturbanceSettings(pose_lag_s=0.1))
    known = [late.measured(k * 0.02, np.array([k * 0.02, 0.0, 0.0]))[0] for k in range(50)]
    np.testing.assert_allclose(known, np.maximum(np.arange(50) * 0.02 - 0.1, 0), atol=1e-9)
    noisy = _disturbances(DisturbanceSettings(pose_noise_m=0.03))
    errors = np.array([noisy.measured(k * 0.02, np.zeros(3)) for k in range(20_000)])
    np.testing.assert_allclose(errors.std(axis=0), [0.03, 0.03, 0.03 / HEADING_ARM_M], rtol=0.03)


def test_the_velocity_bias_is_horizontal_and_drawn_once():
    biases = [_disturbances(seed=seed).velocity_bias_mps for seed in range(5)]
    for bias in biases:
        assert abs(np.linalg.norm(bias) - 0.03) < 1e-12
        assert bias[2] == 0
    assert len({tuple(bias) for bias in biases}) == 5
