"""MuJoCo is the oracle: a small quadruped of the tests' own, and the equations of motion as it solves them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import quadprog
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.wbc import WbcCommand, WbcSettings, WholeBodyControl, WholeBodyState, WholeBodyTargets
from quadlog.control.locomotion.wbc_kernels import QpStatus, commands

SEEDS = st.integers(0, 2**32 - 1)
MASS_KG = 12.8
TROT = np.array([True, False, False, True])
ALL = np.ones(4, dtype=bool)
# Torques by the equations of motion alone, as eq. 43 has them.
PLAIN = WbcSettings(joint_gains=(0.0, 0.0), torque_limit_nm=np.inf)


def leg(name, fore, side):
    return f"""<body pos="{0.18 * fore} {0.047 * side} 0"><joint axis="1 0 0" armature=".01"/>
      <inertial pos="0 {0.03 * side} 0" mass=".6" diaginertia=".001 .001 .001"/>
      <body pos="0 {0.075 * side} 0"><joint axis="0 -1 0" armature=".01"/>
        <inertial pos="0 {-0.01 * side} -.03" mass=".9" diaginertia=".005 .005 .001"/>
        <body pos="0 0 -.22"><joint axis="0 -1 0" armature=".01"/>
          <inertial pos="0 0 -.12" mass=".2" diaginertia=".001 .001 .0001"/>
          <geom pos="0 0 -.22" size=".02" contype="0" conaffinity="1" friction=".8"/>
          <site name="{name}" pos="0 0 -.22"/></body></body></body>"""


XML = f"""<mujoco><option timestep=".002" integrator="implicitfast" cone="elliptic" impratio="10"/><worldbody>
  <geom type="plane" size="0 0 1" contype="1" conaffinity="0" friction=".8"/>
  <body pos="0 0 .3"><freejoint/><inertial pos=".01 0 .02" mass="{MASS_KG - 6.8}" diaginertia=".03 .06 .07"/>
  {leg("lf", 1, 1)}{leg("rf", 1, -1)}{leg("lh", -1, 1)}{leg("rh", -1, -1)}</body></worldbody></mujoco>"""


class Quadruped:
    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.data = mujoco.MjData(self.model)

    def stand(self, knee_rad=1.7):
        self.data.qpos[:] = 0.0
        self.data.qpos[3] = 1.0
        self.data.qpos[7:] = np.tile([0.0, -knee_rad / 2, knee_rad], 4)
        self.data.qpos[2] = 0.44 * np.cos(knee_rad / 2) + 0.02
        self.data.qvel[:] = 0.0
        return self

    def anywhere(self, rng):
        """Tumbling in the air with bent legs, far above the ground."""
        self.data.qpos[:3] = rng.normal(size=3) + np.array([0.0, 0.0, 5.0])
        self.data.qpos[3:7] = Rotation.random(random_state=int(rng.integers(2**31))).as_quat(scalar_first=True)
        self.data.qpos[7:] = rng.uniform(np.tile([-0.5, -1.4, 0.7], 4), np.tile([0.5, 0.2, 2.2], 4))
        self.data.qvel[:] = rng.normal(size=18)
        return self

    def state(self):
        model, data, state = self.model, self.data, WholeBodyState()
        mujoco.mj_forward(model, data)
        rates = np.zeros((4, 3, 18))
        mujoco.mj_fullM(model, data, state.mass_matrix)
        for k in range(4):
            mujoco.mj_jacDot(model, data, rates[k], None, data.site_xpos[k], model.site_bodyid[k])
        state.rotation_body_to_map[:], state.position_m[:] = data.xmat[1].reshape(3, 3), data.qpos[:3]
        state.qvel[:], state.bias[:], state.feet_m[:] = data.qvel, data.qfrc_bias, data.site_xpos
        state.foot_jacobians[:], state.foot_jacobian_rates[:] = self.foot_jacobians(), rates @ data.qvel
        return state

    def foot_jacobians(self):
        jacobians = np.zeros((4, 3, 18))
        for k in range(4):
            mujoco.mj_jacSite(self.model, self.data, jacobians[k], None, k)
        return jacobians

    def acceleration(self, torques_nm, forces_n):
        """(18,) by MuJoCo's forward dynamics, under joint torques and forces on the feet in map."""
        self.data.qfrc_applied[:] = np.einsum("fak,fa->k", self.foot_jacobians(), forces_n)
        self.data.qfrc_applied[6:] += torques_nm
        mujoco.mj_forward(self.model, self.data)
        self.data.qfrc_applied[:] = 0.0
        return self.data.qacc.copy()

    def rates(self, acceleration, measure, h=1e-5):
        """How fast what measure(self) gives changes under an acceleration (18,), by central differences."""
        qpos, qvel, found = self.data.qpos.copy(), self.data.qvel.copy(), []
        for step in (h, -h):
            self.data.qpos[:] = qpos
            mujoco.mj_integratePos(self.model, self.data.qpos, qvel + step / 2 * acceleration, step)
            self.data.qvel[:] = qvel + step * acceleration
            mujoco.mj_forward(self.model, self.data)
            mujoco.mj_subtreeVel(self.model, self.data)
            found.append(measure(self))
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        return (found[0] - found[1]) / (2 * h)

    def velocities(self):
        """(18,) of body and feet in map: angular, linear, and each foot's."""
        feet = self.foot_jacobians() @ self.data.qvel
        omega = self.data.xmat[1].reshape(3, 3) @ self.data.qvel[3:6]
        return np.concatenate([omega, self.data.qvel[:3], feet.ravel()])


@pytest.fixture(scope="module")
def robot():
    return Quadruped()


def near(rng, state, size=1.0):
    """Targets not far from a state."""
    turn = Rotation.from_rotvec(0.1 * size * rng.normal(size=3)).as_matrix()
    body = size * rng.normal(size=(5, 3)) * [[0.03], [1.0], [1.0], [1.0], [1.0]]
    body[0] += state.position_m
    feet = size * rng.normal(size=(3, 4, 3)) * np.array([0.03, 1.0, 1.0])[:, None, None]
    feet[0] += state.feet_m
    return targets_of(turn @ state.rotation_body_to_map, body, feet)


def targets_of(rotation, body, feet):
    targets = WholeBodyTargets()
    targets.rotation_body_to_map[:], targets.body[:], targets.feet[:] = rotation, body, feet
    return targets


def step(control, state, targets, stance, mpc_forces_n):
    """A command of its own, not overwritten by the next."""
    targets.stance[:], targets.forces_n[:] = stance, mpc_forces_n
    return WbcCommand(*(each.copy() if isinstance(each, np.ndarray) else each for each in control.step(state, targets)))


def mpc_only_torques(state, targets, stance, mpc_forces_n, chosen):
    targets.stance[:], targets.forces_n[:] = stance, mpc_forces_n
    return WholeBodyControl(chosen).mpc_only_torques(state, targets)


def command_columns(state, targets, stance):
    """(tasks met weakly, change of q, velocity, acceleration), before the QP."""
    control = WholeBodyControl()
    targets.stance[:] = stance
    weak = commands(state.record, targets.record, control.record)
    return weak, *control.out.T


def any_forces(rng):
    return rng.normal(size=(4, 3)) * 30 + [0.0, 0.0, 50.0]


@given(seed=SEEDS)
def test_tasks_get_the_accelerations_they_ask_for(robot, seed):
    """Velocities in map are differentiated in MuJoCo: that qvel is partly in the body is none of its concern."""
    rng = np.random.default_rng(seed)
    state = robot.anywhere(rng).state()
    targets, stance = near(rng, state), rng.random(4) < 0.6
    weak, _, velocity, acceleration = command_columns(state, targets, stance)
    assert weak == 0
    turn = Rotation.from_matrix(targets.rotation_body_to_map @ state.rotation_body_to_map.T).as_rotvec()
    now = robot.velocities()
    body, feet = targets.body, targets.feet
    wanted_rotation = body[4] + 80 * turn + 8 * (body[2] - now[:3])
    wanted_translation = body[3] + 60 * (body[0] - state.position_m) + 8 * (body[1] - now[3:6])
    wanted_feet = feet[2] + 350 * (feet[0] - state.feet_m) + 30 * (feet[1] - now[6:].reshape(4, 3))
    wanted_feet[stance] = 0.0
    wanted = np.concatenate([wanted_rotation, wanted_translation, wanted_feet.ravel()])
    scale = max(1.0, float(np.abs(acceleration).max()))
    np.testing.assert_allclose(robot.rates(acceleration, Quadruped.velocities), wanted, rtol=0, atol=1e-6 * scale)

    robot.data.qvel[:] = velocity
    wanted_speeds = np.concatenate([body[2], body[1], np.where(stance[:, None], 0.0, feet[1]).ravel()])
    np.testing.assert_allclose(robot.velocities(), wanted_speeds, rtol=0, atol=1e-9)


@given(seed=SEEDS)
def test_the_hierarchy_is_one_18_by_18_solve(robot, seed):
    rng = np.random.default_rng(seed)
    state = robot.anywhere(rng).state()
    targets, stance = near(rng, state), rng.random(4) < 0.6
    _, change, velocity, _ = command_columns(state, targets, stance)
    base = np.zeros((6, 18))
    base[:3, 3:6], base[3:, :3] = state.rotation_body_to_map, np.eye(3)
    rows = np.concatenate([base, *state.foot_jacobians])
    turn = Rotation.from_matrix(targets.rotation_body_to_map @ state.rotation_body_to_map.T).as_rotvec()
    feet = np.where(stance[:, None], 0.0, [targets.feet[0] - state.feet_m, targets.feet[1]])
    moves = np.concatenate([turn, targets.body[0] - state.position_m, feet[0].ravel()])
    speeds = np.concatenate([targets.body[2], targets.body[1], feet[1].ravel()])
    np.testing.assert_allclose(change, np.linalg.solve(rows, moves), rtol=0, atol=1e-10)
    np.testing.assert_allclose(velocity, np.linalg.solve(rows, speeds), rtol=0, atol=1e-9)


def residual(robot, state, targets, stance, mpc_forces_n, qp=PLAIN):
    """How far MuJoCo's accelerations are from those commanded, in parts of the largest."""
    command = step(WholeBodyControl(qp), state, targets, stance, mpc_forces_n)
    found = robot.acceleration(command.torques_nm, command.forces_n)
    return float(np.abs(found - command.qddot_cmd).max() / max(1.0, np.abs(command.qddot_cmd).max()))


@given(seed=SEEDS)
def test_forward_dynamics_gives_the_commanded_accelerations(robot, seed):
    rng = np.random.default_rng(seed)
    state = robot.anywhere(rng).state()
    assert residual(robot, state, near(rng, state), rng.random(4) < 0.6, any_forces(rng)) < 1e-12


@given(seed=SEEDS, weight=st.sampled_from([0.1, 10.0, 1e4]))
def test_forces_against_the_qp_with_its_equality(robot, seed, weight):
    """Both unknowns, change of forces and of base acceleration, and the base's six rows between them; quadprog."""
    rng = np.random.default_rng(seed)
    state = robot.anywhere(rng).state()
    targets, stance, mpc_forces_n = near(rng, state), rng.random(4) < 0.7, any_forces(rng)
    chosen = WbcSettings(weight_acceleration=weight, f_min_n=5.0, f_max_n=120.0)
    control = WholeBodyControl(chosen)
    command = step(control, state, targets, stance, mpc_forces_n)
    assert (command.forces_n[~stance] == 0).all()
    if not stance.any():
        assert command.status is QpStatus.FLIGHT
        return
    assert command.status is QpStatus.SOLVED
    feet = np.flatnonzero(stance)
    n = 3 * len(feet)
    _, _, _, acceleration = command_columns(state, targets, stance)
    to_base = np.concatenate([state.foot_jacobians[k, :, :6] for k in feet]).T
    base = state.mass_matrix[:6] @ acceleration + state.bias[:6]
    equality = np.hstack([-to_base, state.mass_matrix[:6, :6]])
    asked = mpc_forces_n[feet].ravel()
    # The pyramids stand on the ground that the body is wanted along.
    per_foot = np.array([[-1, 0, 0.6], [1, 0, 0.6], [0, -1, 0.6], [0, 1, 0.6], [0, 0, 1], [0, 0, -1]])
    per_foot = per_foot @ targets.rotation_body_to_map.T
    pyramid = np.hstack([np.kron(np.eye(len(feet)), per_foot), np.zeros((6 * len(feet), 6))])
    at_least = np.tile([0, 0, 0, 0, 5.0, -120.0], len(feet)) - pyramid[:, :n] @ asked
    hessian = np.diag([1.0] * n + [weight] * 6)
    bounds = np.concatenate([to_base @ asked - base, at_least])
    x = quadprog.solve_qp(hessian, np.zeros(n + 6), np.vstack([equality, pyramid]).T, bounds, 6)[0]
    np.testing.assert_allclose(command.forces_n[feet].ravel(), asked + x[:n], rtol=0, atol=1e-6)
    np.testing.assert_allclose(command.qddot_cmd[:6], acceleration[:6] + x[n:], rtol=0, atol=1e-6)
    np.testing.assert_allclose(command.qddot_cmd[6:], acceleration[6:])


@pytest.mark.parametrize(("stance", "weak_tasks"), [(TROT, 2), (ALL, 2), (~ALL, 1)])
def test_straight_legs_ask_for_nothing_endless(robot, stance, weak_tasks):
    """No jump as the knees pass through 0 either."""
    before = None
    for knee_rad in np.linspace(0.05, -0.05, 101):
        state = robot.stand(knee_rad).state()
        still = targets_of(np.eye(3), np.zeros((5, 3)), np.zeros((3, 4, 3)))
        still.feet[0] = state.feet_m
        still.body[0] = state.position_m + np.array([0.0, 0.0, 0.01])
        weak, *columns = command_columns(state, still, stance)
        assert weak == weak_tasks
        now = np.stack(columns)
        assert np.abs(now).max() < 60 * 0.01 / 0.02
        assert before is None or np.abs(now - before).max() < 0.5
        before = now


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"weight_force": 0.0}, "weight_force"),
        ({"weight_acceleration": -1.0}, "weight_acceleration"),
        ({"mu": np.nan}, "mu"),
        ({"f_min_n": 200.0}, "f_min_n"),
        ({"torque_limit_nm": 0.0}, "torque_limit_nm"),
        ({"torque_limit_nm": (1.0, 2.0)}, "torque_limit_nm"),
        ({"joint_gains": (1.0, -1.0)}, "gains"),
        ({"swing_gains": (1.0,)}, "gains"),
        ({"weakest": 0.0}, "weakest"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        WbcSettings(**wrong)


@pytest.mark.parametrize("yaw_deg", [0.0, 45.0, 140.0])
@pytest.mark.parametrize(("slope_deg", "mu"), [(15.0, 0.2), (20.0, 0.3), (-20.0, 0.3), (20.0, 0.6)])
def test_a_slope_tilts_the_friction_cone(robot, slope_deg, mu, yaw_deg):
    """A force straight up leans from the normal by the slope: beyond arctan(mu) it is cut to the cone's side."""
    slope = np.radians(slope_deg)
    ground = Rotation.from_euler("ZY", [yaw_deg, slope_deg], degrees=True).as_matrix()
    state = robot.stand().state()
    targets = targets_of(ground, np.zeros((5, 3)), np.zeros((3, 4, 3)))
    targets.body[0], targets.feet[0] = state.position_m, state.feet_m
    # Nothing but nearness to the MPC's forces counts.
    control = WholeBodyControl(WbcSettings(mu=mu, weight_acceleration=0.0))
    found_n = step(control, state, targets, TROT, np.tile([0.0, 0.0, 60.0], (4, 1))).forces_n[TROT]
    if abs(np.tan(slope)) <= mu:
        expected_n = np.array([0.0, 0.0, 60.0])
    else:
        side = np.array([-np.sign(slope) * mu, 0.0, 1.0]) / np.hypot(mu, 1.0)
        expected_n = 60.0 * (mu * abs(np.sin(slope)) + np.cos(slope)) / np.hypot(mu, 1.0) * ground @ side
    np.testing.assert_allclose(found_n, np.tile(expected_n, (2, 1)), rtol=0, atol=1e-6)
