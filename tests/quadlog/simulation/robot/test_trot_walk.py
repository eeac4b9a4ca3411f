from __future__ import annotations

import mujoco
import numpy as np
import pytest

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.messages import Float
from quadlog.results.run.tables import TABLES
from quadlog.simulation.robot.trot import (
    LIFT_M,
    PAIRS,
    SAMPLES_HZ,
    STEP_M,
    OutOfReach,
    TrotRobot,
    TrotWalk,
    joint_targets,
    sampled,
    trot_model,
    walk_trot,
)

PLAN = TrotRobot().plan
RESTING, CYCLE = 2000, 1000


def _feet(joints: Float) -> Float:
    """(N, 4, 3) beside where they stand."""
    feet = np.empty((len(joints), 4, 3))
    for row, angles in zip(feet, joints, strict=True):
        foot_positions(angles, PLAN.hips_m, PLAN.lengths, row)
    return feet - PLAN.standing_feet_m


def _walk(first_pair: int = 0, robot: TrotRobot | None = None) -> TrotWalk:
    robot = robot or TrotRobot()
    # Mirrored, this curve is itself.
    targets = joint_targets(robot.plan, np.array([-0.01, 0.01, 0.01, -0.01]), 1, first_pair)
    return walk_trot(trot_model(robot), targets, np.zeros(12))


@pytest.fixture(scope="module")
def walk() -> TrotWalk:
    return _walk()


def test_feet_are_sent_along_the_curve():
    targets = joint_targets(PLAN, np.array([-0.01, 0.02, 0.01, 0.0]))
    assert targets.shape == (32_000, 12)
    assert (targets[: RESTING + 1] == targets[0]).all()
    np.testing.assert_array_equal(targets[RESTING : RESTING + CYCLE], targets[-CYCLE:])
    feet = _feet(targets[RESTING : RESTING + CYCLE : 10])
    first, second = feet[:, PAIRS == 0], feet[:, PAIRS == 1]
    # Half a period later the other pair does the same.
    np.testing.assert_allclose(first[..., ::2], np.roll(second, 50, axis=0)[..., ::2], atol=1e-12)
    assert first[0, :, 0] == pytest.approx(-STEP_M / 2)
    assert second[0, :, 0] == pytest.approx(STEP_M / 2)
    assert feet[..., 2].max(axis=0) == pytest.approx(LIFT_M, abs=1e-6)
    assert feet[:50, PAIRS == 1, 2] == pytest.approx(0, abs=1e-12)
    assert feet[25, 0, 1] == pytest.approx(-0.01)
    assert feet[75, 1:3, 1] == pytest.approx([0.02, 0.01])
    assert np.abs(feet[:, 3, 1]).max() < 1e-12


def test_a_curve_out_of_reach_is_refused():
    with pytest.raises(OutOfReach, match="500 mm aside"):
        joint_targets(PLAN, np.full(4, 0.5))


def test_the_other_pair_first_mirrors_the_walk_to_a_nanometre(walk):
    other = _walk(1)
    mirror = [1, -1, 1]
    np.testing.assert_allclose(other.position_m, walk.position_m * mirror, atol=1e-9)
    np.testing.assert_allclose(other.rpy_rad, walk.rpy_rad * [-1, 1, -1], atol=1e-8)
    assert np.abs(walk.position_m[:, 1]).max() > 0.005


def test_it_rests_and_then_walks_on(walk):
    assert len(walk.t_ns) == 32 * SAMPLES_HZ + 1
    assert walk.t_ns[-1] == 32_000_000_000
    assert np.ptp(walk.position_m[10:100, 0]) < 1e-3
    assert walk.position_m[-1, 0] == pytest.approx(2 * STEP_M * 30, rel=0.1)
    assert not walk.fallen.any()


def test_feet_carry_the_robot(walk):
    """Momentum: over whole cycles the mean of the feet's loads is the weight, as the body's height comes back."""
    loads = walk.loads_n[501:1601].sum(axis=1)
    assert loads.mean() == pytest.approx(10 * 9.81, rel=0.03)
    # Standing, the load is the weight at every instant.
    assert walk.loads_n[90].sum() == pytest.approx(10 * 9.81, rel=1e-3)


def test_velocities_are_in_the_body_s_heading():
    """Of a robot that has turned far: over whole cycles the mean velocity is the way over the time."""
    robot = TrotRobot()
    walk = walk_trot(trot_model(robot), joint_targets(robot.plan, np.full(4, 0.02)), np.zeros(12))
    cycle = slice(1351, 1601)
    yaw = walk.rpy_rad[cycle, 2]
    assert yaw.mean() > 0.3
    vx, vy = walk.velocity_mps[cycle].T
    gone = (walk.position_m[1600] - walk.position_m[1350]) / 5.0
    assert (np.cos(yaw) * vx - np.sin(yaw) * vy).mean() == pytest.approx(gone[0], abs=0.005)
    assert (np.sin(yaw) * vx + np.cos(yaw) * vy).mean() == pytest.approx(gone[1], abs=0.005)


def test_columns_are_those_of_the_table(walk):
    columns = walk.columns()
    assert set(columns) <= set(TABLES["control"].names)
    assert {len(column) for column in columns.values()} == {len(walk.t_ns)}
    assert np.isfinite(np.column_stack(list(columns.values()))).all()


def test_who_has_fallen_stays_fallen_also_on_its_feet():
    model = trot_model(TrotRobot())
    world = model.model
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.zeros((1000, mujoco.mj_stateSize(world, full)))
    states[:, 3], states[:, 4] = 0.2, 1.0
    states[400:600, 3] = 0.05
    fallen = sampled(model, states[0], states, np.zeros((1000, world.nsensordata))).fallen
    np.testing.assert_array_equal(fallen, np.arange(51) >= 21)


def test_a_load_too_far_ahead_makes_it_fall_and_stay_so():
    walk = _walk(robot=TrotRobot(payload_kg=50.0, payload_x_m=0.4))
    assert walk.fallen[-1]
    first = int(np.argmax(walk.fallen))
    assert walk.fallen[first:].all()
    assert np.isfinite(walk.position_m).all()


def test_rates_are_the_derivatives_of_poses(walk):
    speed, yaw = walk.position_m[:, :2], walk.rpy_rad[:, 2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    gone = np.gradient(speed, 1 / SAMPLES_HZ, axis=0)
    forward = cos * gone[:, 0] + sin * gone[:, 1]
    assert np.corrcoef(forward[100:], walk.velocity_mps[100:, 0])[0, 1] > 0.95
    turned = np.gradient(yaw, 1 / SAMPLES_HZ)
    assert np.corrcoef(turned[100:], walk.yaw_rate_radps[100:])[0, 1] > 0.95
