"""MuJoCo is the oracle, and the equations of motion as it solves them."""

from __future__ import annotations

import mujoco
import numpy as np
import piqp
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.force_qp import Pyramid
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.wbc import WholeBodyControl, WholeBodyTargets, commands
from quadlog.control.settings import MpcSettings
from quadlog.simulation.robot.height_field import flat
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.quadruped import Quadruped

SEEDS = st.integers(0, 2**32 - 1)
MASS_KG = 12.786
TROT = np.array([True, False, False, True])
ALL = np.ones(4, dtype=bool)
# Gains [rotation, translation, swing, joints] and the weight of the base's acceleration, which are not printed.
GAINS = np.array([[80.0, 8.0], [60.0, 8.0], [350.0, 30.0], [20.0, 0.8]])
WEIGHT = 0.1


@pytest.fixture(scope="module")
def robot():
    return Quadruped(quadruped_model(ROBOTS["tracking"], flat()), 0.0, 0.0, 0.0)


def anywhere(robot, rng):
    """The state of the robot tumbling in the air with bent legs, far above the ground."""
    data = robot.data
    data.qpos[:3] = rng.normal(size=3) + np.array([0.0, 0.0, 5.0])
    data.qpos[3:7] = Rotation.random(random_state=int(rng.integers(2**31))).as_quat(scalar_first=True)
    data.qpos[7:] = rng.uniform(np.tile([-0.5, -1.4, 0.7], 4), np.tile([0.5, 0.2, 2.2], 4))
    data.qvel[:] = rng.normal(size=18)
    return robot.read()


def straight(robot, knee_rad):
    """The state of the robot at rest with its feet below its hips."""
    robot.data.qpos[:] = [0, 0, 5, 1, 0, 0, 0, *np.tile([0.0, -knee_rad / 2, knee_rad], 4)]
    robot.data.qvel[:] = 0.0
    return robot.read()


def acceleration(robot, torques_nm, forces_n):
    """(18,) by MuJoCo's forward dynamics, under joint torques and forces on the feet in map."""
    data, jacobians = robot.data, np.zeros((4, 3, 18))
    for jacobian, site in zip(jacobians, robot.model.foot_sites, strict=True):
        mujoco.mj_jacSite(robot.model.model, data, jacobian, None, site)
    data.qfrc_applied[:] = np.einsum("fak,fa->k", jacobians, forces_n)
    data.qfrc_applied[6:] += torques_nm
    mujoco.mj_forward(robot.model.model, data)
    data.qfrc_applied[:] = 0.0
    return data.qacc.copy()


def near(rng, state, size=1.0):
    """Targets not far from a state."""
    turn = Rotation.from_rotvec(0.1 * size * rng.normal(size=3)).as_matrix()
    body = size * rng.normal(size=(3, 3)) * [[0.03], [1.0], [1.0]]
    body[0] += state.position_m
    feet = size * rng.normal(size=(3, 4, 3)) * np.array([0.03, 1.0, 1.0])[:, None, None]
    feet[0] += state.feet_m
    return targets_of(turn @ state.rotation_body_to_map, body, feet)


def targets_of(rotation, body, feet):
    targets = WholeBodyTargets()
    targets.rotation_body_to_map[:], targets.body[:], targets.feet[:] = rotation, body, feet
    return targets


def controlled(state, targets, stance, mpc_forces_n, limits_nm=np.inf):
    """Whole-body control after a step."""
    targets.stance[:], targets.forces_n[:] = stance, mpc_forces_n
    control = WholeBodyControl(Pyramid(MpcSettings(f_max_n=120.0), MASS_KG), limits_nm)
    control.step(state, targets)
    return control


def command_columns(state, targets, stance):
    """Change of q, velocity, acceleration, before the QP: (3, 18)."""
    control = WholeBodyControl(Pyramid(MpcSettings(), MASS_KG), np.inf)
    targets.stance[:] = stance
    commands(state.record, targets.record, control.record)
    return control.out.T


def tasks_of(state, targets, stance):
    """Jacobians of Table 3's tasks in their order, and what each wants: of position, of velocity, of acceleration."""
    base = np.zeros((6, 18))
    base[:3, 3:6], base[3:, :3] = state.rotation_body_to_map, np.eye(3)
    turn = Rotation.from_matrix(targets.rotation_body_to_map @ state.rotation_body_to_map.T).as_rotvec()
    speeds, feet = base @ state.qvel, state.foot_jacobians @ state.qvel
    away, body = targets.body[0] - state.position_m, targets.body
    rotation = turn, body[2], GAINS[0, 0] * turn + GAINS[0, 1] * (body[2] - speeds[:3])
    translation = away, body[1], GAINS[1, 0] * away + GAINS[1, 1] * (body[1] - speeds[3:])
    foot_away = targets.feet[0] - state.feet_m
    swing_mps2 = targets.feet[2] + GAINS[2, 0] * foot_away + GAINS[2, 1] * (targets.feet[1] - feet)
    swing = foot_away, targets.feet[1], swing_mps2 - state.foot_jacobian_rates
    stand = 0 * foot_away, 0 * foot_away, -state.foot_jacobian_rates
    tasks = [(np.concatenate(state.foot_jacobians[stance]) if stance.any() else np.zeros((0, 18)), stand, stance)]
    tasks += [(base[:3], rotation, ...), (base[3:], translation, ...)]
    tasks += [(np.concatenate(state.foot_jacobians[~stance]) if (~stance).any() else np.zeros((0, 18)), swing, ~stance)]
    return [(jacobian, np.stack([each[rows].ravel() for each in wanted])) for jacobian, wanted, rows in tasks]


def recursion(tasks):
    """[Tracking, eqs 33-40], corrected: q_i = q_{i-1} + (J_i N_{i-1})^+ (x_i - J_i q_{i-1}), (3, 18).

    Eq. 34: N_i = I - J_A^+ J_A of the tasks so far. Errata: eq. 36 adds N q_delta to q_{i-1}; eq. 37 has x_i; eq. 40
    has the Jacobian's rate, which stands in what feet in stance want.
    """
    out, above = np.zeros((18, 3)), np.zeros((0, 18))
    for jacobian, wanted in tasks:
        free = np.eye(18) - np.linalg.pinv(above) @ above
        out = out + np.linalg.pinv(jacobian @ free) @ (wanted.T - jacobian @ out)
        above = np.concatenate([above, jacobian])
    return out.T


def any_forces(rng):
    return rng.normal(size=(4, 3)) * 30 + [0.0, 0.0, 50.0]


@given(seed=SEEDS)
def test_the_closed_form_is_the_printed_recursion(robot, seed):
    rng = np.random.default_rng(seed)
    state = anywhere(robot, rng)
    targets, stance = near(rng, state), rng.random(4) < 0.6
    expected = recursion(tasks_of(state, targets, stance))
    np.testing.assert_allclose(command_columns(state, targets, stance), expected, rtol=1e-9, atol=1e-9)


@given(seed=SEEDS)
def test_forward_dynamics_gives_the_commanded_accelerations(robot, seed):
    """Torques less those of eq. 44's feedback, which the equations of motion know nothing of."""
    rng = np.random.default_rng(seed)
    state = anywhere(robot, rng)
    control = controlled(state, near(rng, state), rng.random(4) < 0.6, any_forces(rng))
    moves, speeds, wanted = control.out[6:, 0], control.out[6:, 1] - state.qvel[6:], control.out[:, 2]
    found = acceleration(robot, control.torques_nm - GAINS[3, 0] * moves - GAINS[3, 1] * speeds, control.forces_n)
    assert np.abs(found - wanted).max() < 1e-11 * max(1.0, np.abs(wanted).max())


@given(seed=SEEDS, far=st.sampled_from([0.3, 1.0, 5.0]))
def test_forces_against_the_qp_with_its_equality(robot, seed, far):
    """Both unknowns, change of forces and of base acceleration, and the base's six rows between them; PIQP."""
    rng = np.random.default_rng(seed)
    state = anywhere(robot, rng)
    targets, stance, mpc_forces_n = near(rng, state, far), rng.random(4) < 0.7, any_forces(rng)
    control = controlled(state, targets, stance, mpc_forces_n)
    assert (control.forces_n[~stance] == 0).all()
    assert control.pyramid.failed == 0
    if not stance.any():
        assert control.pyramid.limited == 0
        return
    feet = np.flatnonzero(stance)
    n = 3 * len(feet)
    acceleration = command_columns(state, targets, stance)[2]
    to_base = np.concatenate([state.foot_jacobians[k, :, :6] for k in feet]).T
    base = state.mass_matrix[:6] @ acceleration + state.bias[:6]
    equality = np.hstack([-to_base, state.mass_matrix[:6, :6]])
    asked = mpc_forces_n[feet].ravel()
    # The pyramids stand on the ground that the body is wanted along.
    per_foot = np.array([[-1, 0, 0.6], [1, 0, 0.6], [0, -1, 0.6], [0, 1, 0.6], [0, 0, 1], [0, 0, -1]])
    per_foot = per_foot @ targets.rotation_body_to_map.T
    pyramid = np.hstack([np.kron(np.eye(len(feet)), per_foot), np.zeros((6 * len(feet), 6))])
    at_least = np.tile([0, 0, 0, 0, 0, -120.0], len(feet)) - pyramid[:, :n] @ asked
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = 1e-9
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.0
    hessian, A, G = (np.asfortranarray(each) for each in (np.diag([1.0] * n + [WEIGHT] * 6), equality, pyramid))
    solver.setup(hessian, np.zeros(n + 6), A, to_base @ asked - base, G, at_least)
    assert solver.solve() == piqp.PIQP_SOLVED
    x = solver.result.x
    np.testing.assert_allclose(control.forces_n[feet].ravel(), asked + x[:n], rtol=0, atol=1e-5)
    np.testing.assert_allclose(control.out[:6, 2], acceleration[:6] + x[n:], rtol=0, atol=1e-5)
    np.testing.assert_allclose(control.out[6:, 2], acceleration[6:])


@pytest.mark.parametrize("stance", [TROT, ALL, ~ALL])
def test_straight_legs_ask_for_nothing_endless(robot, stance):
    """No jump as the knees pass through 0, nor where damping begins."""
    before = None
    for knee_rad in np.linspace(0.3, -0.3, 601):
        state = straight(robot, knee_rad)
        still = targets_of(np.eye(3), np.zeros((3, 3)), np.zeros((3, 4, 3)))
        still.feet[0] = state.feet_m
        still.body[0] = state.position_m + np.array([0.0, 0.0, 0.01])
        now = command_columns(state, still, stance).copy()
        assert np.abs(now).max() < 60 * 0.01 / 0.02
        assert before is None or np.abs(now - before).max() < 1.0
        before = now


def test_torques_are_cut_to_their_limits_and_what_is_no_number_is_none(robot):
    rng = np.random.default_rng(0)
    state = anywhere(robot, rng)
    targets, forces_n = near(rng, state), any_forces(rng)
    free = controlled(state, targets, TROT, forces_n).torques_nm
    most_nm = float(np.median(np.abs(free)))
    cut = controlled(state, targets, TROT, forces_n, limits_nm=most_nm)
    np.testing.assert_array_equal(cut.torques_nm, np.clip(free, -most_nm, most_nm))
    assert cut.saturated.sum() == 6
    state.qvel[7] = np.nan
    lost = controlled(state, targets, TROT, forces_n)
    assert np.isfinite(lost.torques_nm).all()
    assert lost.pyramid.failed == 1


@pytest.mark.parametrize("yaw_deg", [0.0, 45.0, 140.0])
@pytest.mark.parametrize(("slope_deg", "mu"), [(15.0, 0.2), (20.0, 0.3), (-20.0, 0.3), (20.0, 0.6)])
def test_a_slope_tilts_the_friction_cone(slope_deg, mu, yaw_deg):
    """A force straight up leans from the normal by the slope: beyond arctan(mu) it is cut to the cone's side."""
    slope = np.radians(slope_deg)
    ground = Rotation.from_euler("ZY", [yaw_deg, slope_deg], degrees=True).as_matrix()
    # Nothing but nearness to the MPC's forces counts.
    pyramid = Pyramid(MpcSettings(mu=mu), MASS_KG)
    along_n = ground.T @ [0.0, 0.0, 60.0]
    found_n = ground @ pyramid.solve(np.eye(3), -along_n, along_n[None])
    assert pyramid.limited == (abs(np.tan(slope)) > mu)
    if abs(np.tan(slope)) <= mu:
        expected_n = np.array([0.0, 0.0, 60.0])
    else:
        side = np.array([-np.sign(slope) * mu, 0.0, 1.0]) / np.hypot(mu, 1.0)
        expected_n = 60.0 * (mu * abs(np.sin(slope)) + np.cos(slope)) / np.hypot(mu, 1.0) * ground @ side
    np.testing.assert_allclose(found_n, expected_n, rtol=0, atol=1e-6)
