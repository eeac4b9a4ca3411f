"""The MPC's cost against a plain model rolled out, its forces against solvers that quadlog does not use."""

from __future__ import annotations

import daqp
import numpy as np
import piqp
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.force_qp import Pyramid
from quadlog.control.locomotion.mpc import ALPHA, DT_S, LEVEL, WEIGHTS, Mpc
from quadlog.control.settings import MpcSettings

MASS_KG = 12.786
WEIGHT_N = MASS_KG * 9.81
INERTIA = np.array([[0.07, 0.005, -0.01], [0.005, 0.25, 0.0], [-0.01, 0.0, 0.28]])
HIPS_M = np.array([[0.18, 0.12, 0], [0.18, -0.12, 0], [-0.18, 0.12, 0], [-0.18, -0.12, 0]])
HEIGHT_M, STEPS = 0.29, 10
ALL_STAND = np.ones((STEPS, 4), dtype=bool)
STANDING = np.array([0, 0, 0, 0, 0, HEIGHT_M, 0, 0, 0, 0, 0, 0], dtype=float)
HILL = Rotation.from_euler("ZYX", [2.0, 0.35, -0.1]).as_matrix()
ARMS_M = np.tile(HIPS_M - [0, 0, HEIGHT_M], (STEPS, 1, 1))


def _random_problem(seed, scale):
    """State, reference, lever arms and contacts of a robot that is up to `scale` away from where it should be."""
    random = np.random.default_rng(seed)
    state = STANDING + scale * random.normal(size=12) * np.repeat([0.05, 0.03, 0.3, 0.3], 3)
    state[2] = random.uniform(-np.pi, np.pi)
    reference = np.tile(STANDING, (STEPS, 1))
    reference[:, 2] = state[2] + scale * random.normal(scale=0.1)
    turn = Rotation.from_euler("z", state[2]).as_matrix()
    arms_m = (ARMS_M + random.normal(scale=0.03, size=(4, 3))) @ turn.T
    contacts = random.random((STEPS, 4)) < random.choice([0.4, 0.6, 1.0])
    contacts[0, seed % 4] = True
    return state, reference, arms_m, contacts


def _mpc(mass_kg=MASS_KG, **settings):
    return Mpc(mass_kg, INERTIA, Pyramid(MpcSettings(**settings), mass_kg))


def _qp(mpc, problem):
    """H, g over forces in map, and the pyramid's rows @ f >= lower, these written here anew."""
    s, ground_to_map = mpc.pyramid, problem[-1]
    H, g = (each.copy() for each in mpc.condense(*problem[:-1], LEVEL))
    rows = np.array([[-1, 0, s.mu], [1, 0, s.mu], [0, -1, s.mu], [0, 1, s.mu], [0, 0, 1], [0, 0, -1]])
    rows, feet = rows @ ground_to_map.T, len(g) // 3
    return H, g, np.kron(np.eye(feet), rows), np.tile([0, 0, 0, 0, 0, -s.f_max_n], feet)


@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("ground", [LEVEL, HILL], ids=["level", "hill"])
def test_forces_are_those_of_an_independent_solver(scale, ground):
    active = 0
    for seed in range(8):
        mpc = _mpc()
        problem = *_random_problem(seed, scale), ground
        solution = mpc.solve(*problem)
        assert (mpc.solves, mpc.pyramid.failed) == (1, 0)
        H, g, rows, lower = _qp(mpc, problem)
        solver = piqp.DenseSolver()
        # Cost in units that make its numbers near 1, and no relative tolerance: that alone leaves some 1e-6 N.
        solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = 1e-10
        solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.0
        solver.settings.max_iter = 1000
        solver.setup(np.asfortranarray(H * 1e4), g * 1e4, G=np.asfortranarray(rows), h_l=lower)
        assert solver.solve() == piqp.PIQP_SOLVED
        found = solution[problem[3]].ravel()
        np.testing.assert_allclose(found, solver.result.x, atol=1e-6, rtol=0)
        active += (rows @ found - lower < 1e-6).sum()
        assert (rows @ found - lower).min() >= -1e-9
    assert active > 0 or scale < 1


def test_swing_feet_have_no_force_and_flight_needs_no_solver():
    contacts = ALL_STAND.copy()
    contacts[:3] = False
    contacts[3:, 1:3] = False
    arms_m = ARMS_M.copy()
    arms_m[~contacts] = np.nan
    mpc, reference = _mpc(), np.tile(STANDING, (STEPS, 1))
    forces_n = mpc.solve(STANDING, reference, arms_m, contacts)
    assert not forces_n[~contacts].any()
    assert forces_n[3:, 0, 2].min() > 1
    solved = mpc.pyramid.limited
    assert not mpc.solve(STANDING, reference, arms_m, np.zeros_like(contacts)).any()
    assert (mpc.solves, mpc.pyramid.limited, mpc.pyramid.failed) == (2, solved, 0)


@pytest.mark.parametrize("broken", ["solver", "state"])
def test_where_no_solver_has_an_answer_the_feet_share_the_weight_and_it_is_counted(monkeypatch, broken):
    state, reference, arms_m, _ = _random_problem(1, 5.0)
    if broken == "state":
        state[7] = np.nan
    else:
        monkeypatch.setattr(daqp, "solve", lambda H, g, *_: (np.full(len(g), np.nan), np.nan, -1, {}))
    contacts, mpc = ALL_STAND.copy(), _mpc()
    contacts[:, 1:3] = False
    shared = mpc.solve(state, reference, arms_m, contacts)
    assert (mpc.pyramid.limited, mpc.pyramid.failed) == (1, 1)
    np.testing.assert_allclose(shared[:, [0, 3]], np.tile([0, 0, WEIGHT_N / 2], (STEPS, 2, 1)))
    assert not shared[:, 1:3].any()
    # A weight above what the feet may carry is clipped.
    heavy = _mpc(100.0, f_max_n=150.0).solve(state, reference, arms_m, contacts)[0]
    np.testing.assert_allclose(heavy[[0, 3], 2], 150)
    # Upright forces on ground that is steeper than friction holds lean into its pyramid.
    steep = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    along = mpc.solve(state, reference, arms_m, contacts, steep)[0] @ steep
    np.testing.assert_allclose(abs(along[[0, 3], 0]), 0.6 * along[[0, 3], 2])
    np.testing.assert_allclose(along[[0, 3], 2], WEIGHT_N / 2 * np.cos(np.pi / 4))


def test_a_foot_may_bear_more_than_the_weight_unless_it_is_limited():
    assert Pyramid(MpcSettings(), 50.0).f_max_n == pytest.approx(1.2 * 50 * 9.81)
    assert Pyramid(MpcSettings(f_max_n=70.0), 50.0).f_max_n == 70


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
    mpc = _mpc()
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
