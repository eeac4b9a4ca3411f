"""The linear model against the nonlinear one, differentiated numerically, and against the matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.mpc_model import continuous_model, discrete_model, skew, yaw_rotation

MASS_KG = 12.786
INERTIA = np.array([[0.07, 0.005, -0.01], [0.005, 0.25, 0.0], [-0.01, 0.0, 0.28]])
ARMS_M = np.array([[0.2, 0.12, -0.29], [0.17, -0.13, -0.3], [-0.16, 0.12, -0.28], [-0.2, -0.1, -0.29]])
YAWS_RAD = [0.0, 0.7, np.pi / 2, -2.5, np.pi]


def _derivative(state, forces_n):
    """Nonlinear motion; Theta' from turning the attitude a little by omega, in map."""
    attitude, dt = Rotation.from_euler("ZYX", state[[2, 1, 0]]), 1e-6
    ahead, behind = (
        (Rotation.from_rotvec(sign * dt * state[6:9]) * attitude).as_euler("ZYX")[::-1] for sign in (1, -1)
    )
    inertia = attitude.as_matrix() @ INERTIA @ attitude.as_matrix().T
    torque = np.cross(ARMS_M, forces_n).sum(axis=0) - np.cross(state[6:9], inertia @ state[6:9])
    acceleration = forces_n.sum(axis=0) / MASS_KG + [0, 0, -9.81]
    turn = (ahead - behind + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([turn / (2 * dt), state[9:], np.linalg.solve(inertia, torque), acceleration])


@pytest.mark.parametrize("yaw_rad", YAWS_RAD)
def test_the_model_is_the_motions_derivative_at_rest(yaw_rad):
    model = continuous_model(MASS_KG, INERTIA, yaw_rad, ARMS_M)
    rest, step = np.zeros(12), 1e-3
    rest[2] = yaw_rad
    no_force = np.zeros((4, 3))
    np.testing.assert_allclose(_derivative(rest, no_force), model.gravity, atol=1e-9)
    for column, unit in enumerate(np.eye(12)):
        change = (_derivative(rest + step * unit, no_force) - _derivative(rest - step * unit, no_force)) / (2 * step)
        np.testing.assert_allclose(change, model.A[:, column], atol=1e-6)
        forced = _derivative(rest, unit.reshape(4, 3)) - _derivative(rest, no_force)
        np.testing.assert_allclose(forced, model.B[:, column], atol=1e-9)


@pytest.mark.parametrize("yaw_rad", YAWS_RAD)
def test_euler_differs_from_the_exact_step_by_half_a_steps_response_alone(yaw_rad):
    dt_s = 0.03
    model = continuous_model(MASS_KG, INERTIA, yaw_rad, ARMS_M)
    euler = discrete_model(model, dt_s)
    held = np.zeros((25, 25))
    held[:12, :12], held[:12, 12:24], held[:12, 24] = model.A, model.B, model.gravity
    exact = expm(held * dt_s)
    half = dt_s**2 / 2 * model.A
    np.testing.assert_allclose(euler.A, exact[:12, :12], atol=1e-14)
    np.testing.assert_allclose(euler.B + half @ model.B, exact[:12, 12:24], atol=1e-14)
    np.testing.assert_allclose(euler.gravity + half @ model.gravity, exact[:12, 24], atol=1e-14)
    assert abs(exact[5, 24] - euler.gravity[5]) == pytest.approx(0.0044, abs=1e-4)


def test_rotation_and_skew():
    np.testing.assert_allclose(yaw_rotation(0.4), Rotation.from_euler("z", 0.4).as_matrix(), atol=1e-15)
    a, b = np.array([0.3, -1.2, 0.5]), np.array([2.0, 0.1, -0.7])
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)
