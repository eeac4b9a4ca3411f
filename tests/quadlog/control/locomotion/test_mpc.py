"""The MPC against solvers that quadlog does not use; `test_walker` and `test_walking_robot` walk under its forces."""

from __future__ import annotations

import daqp
import numpy as np
import piqp
import pytest
import quadprog
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.mpc import LEVEL, Mpc, MpcSettings, MpcStatus
from quadlog.control.locomotion.mpc_model import build_cost

MASS_KG = 12.786
WEIGHT_N = MASS_KG * 9.81
INERTIA = np.array([[0.07, 0.0, 0.004], [0.0, 0.25, 0.0], [0.004, 0.0, 0.28]])
HIPS_M = np.array([[0.18, 0.12, 0], [0.18, -0.12, 0], [-0.18, 0.12, 0], [-0.18, -0.12, 0]])
HEIGHT_M, DT_S, STEPS = 0.29, 0.03, 10
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


def _qp(mpc, state, reference, arms_m, contacts, ground_to_map):
    """H, g and the pyramid's rows @ f >= lower, these written here anew."""
    s = mpc.settings
    H, g, _ = build_cost(
        state, reference, arms_m, contacts, MASS_KG, np.linalg.inv(INERTIA), s.weights(), s.alpha, s.dt_s
    )
    rows = np.array([[-1, 0, s.mu], [1, 0, s.mu], [0, -1, s.mu], [0, 1, s.mu], [0, 0, 1], [0, 0, -1]])
    rows, feet = rows @ ground_to_map.T, len(g) // 3
    return H, g, np.kron(np.eye(feet), rows), np.tile([0, 0, 0, 0, s.f_min_n, -s.f_max_n], feet)


@pytest.mark.parametrize("f_min_n", [0.0, 4.0])
@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("ground", [LEVEL, HILL], ids=["level", "hill"])
def test_forces_are_those_of_an_independent_solver(scale, f_min_n, ground):
    active = 0
    for seed in range(8):
        mpc = Mpc(MASS_KG, INERTIA, MpcSettings(f_min_n=f_min_n))
        problem = _random_problem(seed, scale)
        solution = mpc.solve(*problem, ground)
        assert solution.status == MpcStatus.SOLVED
        H, g, rows, lower = _qp(mpc, *problem, ground)
        solver = piqp.DenseSolver()
        # Cost in units that make its numbers near 1, and no relative tolerance: that alone leaves some 1e-6 N.
        solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = 1e-10
        solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.0
        solver.settings.max_iter = 1000
        solver.setup(np.asfortranarray(H * 1e4), g * 1e4, G=np.asfortranarray(rows), h_l=lower)
        assert solver.solve() == piqp.PIQP_SOLVED
        found = solution.all_forces_n[problem[3]].ravel()
        np.testing.assert_allclose(found, solver.result.x, atol=1e-6, rtol=0)
        active += (rows @ found - lower < 1e-6).sum()
        # KKT: within the pyramid, and the gradient is a sum of active rows with multipliers >= 0.
        assert (rows @ found - lower).min() >= -1e-9
        held = rows[rows @ found - lower < 1e-7]
        gradient = H @ found + g
        miss = nnls(held.T, gradient)[1] if len(held) else np.linalg.norm(gradient)
        assert miss < 1e-9 * max(1.0, abs(g).max())
    assert active > 0 or scale < 1


def test_swing_feet_have_no_force_and_flight_needs_no_solver():
    contacts = ALL_STAND.copy()
    contacts[:3] = False
    contacts[3:, 1:3] = False
    arms_m = ARMS_M.copy()
    arms_m[~contacts] = np.nan
    mpc, reference = Mpc(MASS_KG, INERTIA), np.tile(STANDING, (STEPS, 1))
    solution = mpc.solve(STANDING, reference, arms_m, contacts)
    assert solution.status == MpcStatus.SOLVED
    assert not solution.all_forces_n[~contacts].any()
    assert solution.all_forces_n[3:, 0, 2].min() > 1
    solution = mpc.solve(STANDING, reference, arms_m, np.zeros_like(contacts))
    assert (solution.status, solution.iterations) == (MpcStatus.FLIGHT, 0)
    assert not solution.all_forces_n.any()


@pytest.fixture
def no_solver(monkeypatch):
    """Both solvers give up, and no unconstrained minimum is allowed."""

    def breaks(*_):
        raise ValueError("constraints are inconsistent, no solution")

    def gives_up(H, g, *_):
        return np.full(len(g), np.nan), np.nan, -1, {"iterations": 7}

    def break_solvers():
        monkeypatch.setattr(quadprog, "solve_qp", breaks)
        monkeypatch.setattr(daqp, "solve", gives_up)

    return break_solvers


def test_when_both_solvers_fail_and_other_feet_stand_they_share_the_weight(no_solver):
    mpc = Mpc(MASS_KG, INERTIA)
    state, reference, arms_m, _ = _random_problem(1, 5.0)
    mpc.solve(state, reference, arms_m, ALL_STAND)
    no_solver()
    contacts = ALL_STAND.copy()
    contacts[:, 1:3] = False
    shared = mpc.solve(state, reference, arms_m, contacts)
    assert shared.status == MpcStatus.SHARED
    np.testing.assert_allclose(shared.forces_n[[0, 3]], np.tile([0, 0, WEIGHT_N / 2], (2, 1)))
    assert not shared.forces_n[1:3].any()
    # A weight above what the feet may carry is clipped.
    heavy = Mpc(100.0, INERTIA).solve(state, reference, arms_m, contacts)
    np.testing.assert_allclose(heavy.forces_n[[0, 3], 2], 150)
    # Upright forces on ground that is steeper than friction holds lean into its pyramid.
    steep = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    along = Mpc(MASS_KG, INERTIA).solve(state, reference, arms_m, contacts, steep).forces_n @ steep
    np.testing.assert_allclose(abs(along[[0, 3], 0]), 0.6 * along[[0, 3], 2])
    np.testing.assert_allclose(along[[0, 3], 2], WEIGHT_N / 2 * np.cos(np.pi / 4))


@pytest.mark.parametrize(
    "wrong",
    [
        {"horizon": 0},
        {"horizon": 10_000},
        {"dt_s": 0.0},
        {"alpha": 0.0},
        {"mu": -0.1},
        {"mu": np.nan},
        {"f_min_n": -1.0},
        {"f_min_n": 200.0},
        {"f_max_n": np.inf},
        {"weight_rpy": (1.0, 2.0)},
        {"weight_omega": (1.0, -2.0, 1.0)},
    ],
)
def test_settings_without_a_solution_are_refused(wrong):
    with pytest.raises(ValueError):
        MpcSettings(**wrong)
