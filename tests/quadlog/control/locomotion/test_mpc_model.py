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
