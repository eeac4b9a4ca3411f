import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.wbc import SIZE
from quadlog.simulation.robot.height_field import flat
from quadlog.simulation.robot.model import QuadrupedModel, quadruped_model
from quadlog.simulation.robot.quadruped import Quadruped

ROBOT = ROBOTS["tracking"]


@pytest.fixture(scope="module")
def model() -> QuadrupedModel:
    return quadruped_model(ROBOT, flat())


def tumbling(model: QuadrupedModel, seed: int) -> Quadruped:
    """In the air, every joint and the trunk in motion."""
    rng, quadruped = np.random.default_rng(seed), Quadruped(model, 0.0, 0.0, 0.0)
    data = quadruped.data
    data.qpos[:3] = rng.uniform([-1, -1, 2], [1, 1, 4])
    data.qpos[3:7] = Rotation.from_rotvec(rng.uniform(-2, 2, 3)).as_quat()[[3, 0, 1, 2]]
    data.qpos[7:] += rng.uniform(-0.5, 0.5, 12)
    data.qvel[:] = rng.uniform(-3, 3, SIZE)
    return quadruped


def feet_at(model: QuadrupedModel, qpos: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model.model, data)
    return data.site_xpos[model.foot_sites].copy()


def moved(model: QuadrupedModel, qpos: np.ndarray, qvel: np.ndarray, dt_s: float) -> np.ndarray:
    qpos = qpos.copy()
    mujoco.mj_integratePos(model.model, qpos, qvel, dt_s)
    return qpos


def jacobians_at(model: QuadrupedModel, qpos: np.ndarray) -> np.ndarray:
    """(4, 3, 18) by central differences of the feet's positions."""
    h = 1e-5
    ways = [feet_at(model, moved(model, qpos, e, h)) - feet_at(model, moved(model, qpos, e, -h)) for e in np.eye(SIZE)]
    return np.stack(ways, axis=-1) / (2 * h)


@pytest.mark.parametrize("seed", range(2))
def test_jacobians_and_their_change_are_finite_differences_of_the_feet(model, seed):
    quadruped = tumbling(model, seed)
    qpos, qvel, state = quadruped.data.qpos.copy(), quadruped.data.qvel.copy(), quadruped.read()
    np.testing.assert_allclose(state.foot_jacobians, jacobians_at(model, qpos), atol=1e-8)
    h = 1e-4
    change = jacobians_at(model, moved(model, qpos, qvel, h)) - jacobians_at(model, moved(model, qpos, qvel, -h))
    np.testing.assert_allclose(state.foot_jacobian_rates, change @ qvel / (2 * h), atol=2e-5, rtol=1e-5)


@pytest.mark.parametrize("seed", range(2))
def test_pose_mass_and_bias_are_mujocos(model, seed):
    quadruped = tumbling(model, seed)
    qpos, qvel, state = quadruped.data.qpos.copy(), quadruped.data.qvel.copy(), quadruped.read()
    rotation = Rotation.from_quat(qpos[[4, 5, 6, 3]])
    np.testing.assert_array_equal(state.position_m, qpos[:3])
    np.testing.assert_array_equal(state.qvel, qvel)
    np.testing.assert_allclose(state.rotation_body_to_map, rotation.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(state.rpy, rotation.as_euler("ZYX")[::-1], atol=1e-9)
    np.testing.assert_allclose(state.feet_m, feet_at(model, qpos), atol=1e-12)
    data = mujoco.MjData(model.model)
    data.qpos[:], data.qvel[:] = quadruped.data.qpos, quadruped.data.qvel
    mujoco.mj_forward(model.model, data)
    np.testing.assert_allclose(state.bias, data.qfrc_bias, atol=1e-12)
    assert data.ncon == 0
    # M qddot + bias is what it takes to accelerate so, one column of M after the other.
    for row, e in enumerate(np.eye(SIZE)):
        data.qacc[:] = e
        mujoco.mj_inverse(model.model, data)
        np.testing.assert_allclose(state.mass_matrix[:, row] + state.bias, data.qfrc_inverse, atol=1e-10)


def test_a_foot_touches_when_it_is_no_higher_than_its_radius(model):
    quadruped, data, rng = Quadruped(model, 0.0, 0.0, 0.3), mujoco.MjData(model.model), np.random.default_rng(2)
    wanted = quadruped.data.qpos[model.joint_qpos].copy()
    seen = set()
    for tick in range(600):
        state = quadruped.read()
        touches = state.touches
        np.testing.assert_array_equal(touches, state.feet_m[:, 2] <= ROBOT.foot_radius_m)
        seen.add(tuple(touches.tolist()))
        if tick % 50 == 0:
            lifts = rng.uniform(-0.3, 0.3, 12)
        off = wanted + lifts - quadruped.data.qpos[model.joint_qpos]
        quadruped.act(200 * off - 4 * quadruped.data.qvel[model.joint_qvel])
        assert data.time == 0
    assert len(seen) > 5


def test_foot_loads_sum_to_the_vertical_constraint_force(model):
    quadruped, rng = Quadruped(model, 0.0, 0.0, 0.0), np.random.default_rng(1)
    for _ in range(50):
        quadruped.read()
        quadruped.act(rng.uniform(-4, 4, 12))
        # On level ground normals are vertical: MuJoCo's own sum of constraint forces on the trunk's height.
        assert quadruped.foot_loads_n().sum() == pytest.approx(quadruped.data.qfrc_constraint[2], abs=1e-9)


def momentum(quadruped: Quadruped) -> np.ndarray:
    mujoco.mj_subtreeVel(quadruped.model.model, quadruped.data)
    return ROBOT.mass_kg * quadruped.data.subtree_linvel[quadruped.model.trunk_body]


def test_a_push_changes_the_momentum_for_one_tick(model):
    quadruped, dt_s = Quadruped(model, 0.0, 0.0, 0.0), model.model.opt.timestep
    quadruped.data.qpos[2] = 3.0
    weight_n = np.array([0, 0, -9.81 * ROBOT.mass_kg])
    for push_n in (np.array([30.0, -60.0, 5.0]), None):
        quadruped.read()
        before = momentum(quadruped).copy()
        quadruped.act(np.zeros(12), push_n)
        quadruped.read()
        change = momentum(quadruped) - before
        np.testing.assert_allclose(change, dt_s * (weight_n + (0 if push_n is None else push_n)), rtol=1e-3, atol=1e-3)
