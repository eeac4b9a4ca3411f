"""The MPC's cost against a plain linear model rolled out, and that model against the nonlinear body."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.force_qp import Pyramid
from quadlog.control.locomotion.mpc import ALPHA, DT_S, LEVEL, WEIGHTS, Mpc
from quadlog.control.settings import MpcSettings

MASS_KG = 12.786
INERTIA = np.array([[0.07, 0.005, -0.01], [0.005, 0.25, 0.0], [-0.01, 0.0, 0.28]])
GRAVITY = -9.81 * np.eye(12)[11]
FEET_M = np.array([[0.2, 0.12, -0.29], [0.17, -0.13, -0.3], [-0.16, 0.12, -0.28], [-0.2, -0.1, -0.29]])


def linear_model(yaw_rad, arms_m):
    """A and B (12, 12) of x' = A x + B u + GRAVITY: Theta' = T_z^T omega [Tracking, eqs 8 and 14, corrected]."""
    to_map = Rotation.from_euler("z", yaw_rad).as_matrix()
    inverse_in_map = np.linalg.inv(to_map @ INERTIA @ to_map.T)
    A, B = np.zeros((12, 12)), np.zeros((12, 12))
    A[:3, 6:9], A[3:6, 9:] = to_map.T, np.eye(3)
    for leg, arm_m in enumerate(arms_m):
        B[6:9, 3 * leg : 3 * leg + 3] = inverse_in_map @ np.cross(arm_m, np.eye(3)).T
        B[9:, 3 * leg : 3 * leg + 3] = np.eye(3) / MASS_KG
    return A, B


def derivative(state, forces_n):
    """Nonlinear motion; Theta' from turning the attitude a little by omega, in map."""
    attitude, dt = Rotation.from_euler("ZYX", state[[2, 1, 0]]), 1e-6
    ahead, behind = (
        (Rotation.from_rotvec(sign * dt * state[6:9]) * attitude).as_euler("ZYX")[::-1] for sign in (1, -1)
    )
    inertia = attitude.as_matrix() @ INERTIA @ attitude.as_matrix().T
    torque = np.cross(FEET_M, forces_n).sum(axis=0) - np.cross(state[6:9], inertia @ state[6:9])
    acceleration = forces_n.sum(axis=0) / MASS_KG + [0, 0, -9.81]
    turn = (ahead - behind + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([turn / (2 * dt), state[9:], np.linalg.solve(inertia, torque), acceleration])


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, np.pi / 2, -2.5, np.pi])
def test_the_linear_model_is_the_motions_derivative_at_rest(yaw_rad):
    A, B = linear_model(yaw_rad, FEET_M)
    rest, step, no_force = yaw_rad * np.eye(12)[2], 1e-3, np.zeros((4, 3))
    np.testing.assert_allclose(derivative(rest, no_force), GRAVITY, atol=1e-9)
    for column, unit in enumerate(np.eye(12)):
        change = (derivative(rest + step * unit, no_force) - derivative(rest - step * unit, no_force)) / (2 * step)
        np.testing.assert_allclose(change, A[:, column], atol=1e-6)
        forced = derivative(rest, unit.reshape(4, 3)) - derivative(rest, no_force)
        np.testing.assert_allclose(forced, B[:, column], atol=1e-9)


def stacked(state, reference, arms_m, contacts, yaw_rad):
    """H and g of J = sum (x - x_ref)^T Q (x - x_ref) + alpha f^T f, halved, by rolling the model out in Euler steps."""
    steps = len(reference)
    free, response = state, np.zeros((12, 12 * steps))
    H, g = ALPHA * np.eye(12 * steps), np.zeros(12 * steps)
    for step in range(steps):
        A, B = linear_model(yaw_rad, arms_m[step])
        free, response = free + DT_S * (A @ free + GRAVITY), response + DT_S * A @ response
        response[:, 12 * step : 12 * step + 12] = DT_S * B
        H += response.T @ np.diag(WEIGHTS) @ response
        g += response.T @ (WEIGHTS * (free - reference[step]))
    stands = np.repeat(contacts.ravel(), 3)
    return H[np.ix_(stands, stands)], g[stands]


@pytest.mark.parametrize("seed", range(6))
def test_cost_is_that_of_the_rolled_out_model(seed):
    random = np.random.default_rng(seed)
    steps = [1, 2, 5, 10, 10, 7][seed]
    state = random.normal(size=12)
    reference = state + random.normal(scale=0.3, size=(steps, 12))
    arms_m = random.normal(scale=0.3, size=(steps, 4, 3))
    contacts = random.random((steps, 4)) < 0.6
    contacts[0, 0] = True
    mpc = Mpc(MASS_KG, INERTIA, Pyramid(MpcSettings(), MASS_KG))
    ground = LEVEL if seed % 2 else Rotation.random(random_state=seed).as_matrix()
    # A yaw that jumps by whole turns is the same reference.
    jumping = reference + 2 * np.pi * random.integers(-2, 3, (steps, 1)) * np.eye(12)[2]
    H, g = mpc.condense(state, jumping, arms_m, contacts, ground)
    expected_H, expected_g = stacked(state, reference, arms_m, contacts, np.mean([state[2], *reference[:-1, 2]]))
    turn = np.kron(np.eye(contacts.sum()), ground)
    expected_H, expected_g = turn.T @ expected_H @ turn, turn.T @ expected_g
    np.testing.assert_allclose(H, expected_H, rtol=1e-10, atol=1e-13 * abs(expected_H).max())
    np.testing.assert_allclose(g, expected_g, rtol=1e-10, atol=1e-13 * abs(expected_g).max())
    np.testing.assert_array_equal(H, H.T)
