from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.messages import Float
from quadlog.simulation.robot.trot import (
    HEIGHT_M,
    LIFT_M,
    PAIRS,
    SAMPLES_HZ,
    STEP_M,
    OutOfReach,
    TrotRobot,
    TrotWalk,
    gravity_moment_nm,
    hip_inertia_kgm2,
    joint_targets,
    trot_model,
    walk_trot,
)

LINK_M, ASIDE_M, LEG_KG = 0.21, 0.07, 0.4


def _knee() -> tuple[float, float]:
    """How far the knee is behind and below the hip: thigh and shank are as long as one another."""
    down = (HEIGHT_M - 0.02) / 2
    return math.sqrt(LINK_M**2 - down**2), down


def test_the_gravity_moment_is_that_of_eq_8():
    """M about x with M = 4 m, d of even rods: half as far behind as the knee, for thigh and shank alike."""
    behind, _ = _knee()
    moment = 4 * LEG_KG * 9.81 * behind / 2
    length, width = 0.36, 0.12 + 2 * ASIDE_M
    expected = -moment * length * width / (length**2 + width**2)
    assert gravity_moment_nm(trot_model(TrotRobot())) == pytest.approx(expected, rel=1e-4)


def test_the_hip_inertia_is_that_of_two_rods():
    """Even rods from z = 0 to -down and on to -2 down, at the side of the axis; the rod's own girth is small."""
    _, down = _knee()
    heights = (down**2 / 3, 7 * down**2 / 3)
    expected = sum(LEG_KG / 2 * (ASIDE_M**2 + height) for height in heights)
    assert hip_inertia_kgm2(trot_model(TrotRobot())) == pytest.approx(expected, rel=0.01)


def test_a_payload_shifts_the_centre_of_mass_to_where_it_is():
    def centre(robot: TrotRobot) -> np.ndarray:
        model = trot_model(robot)
        data = mujoco.MjData(model.model)
        data.qpos[model.joint_qpos] = model.robot.standing_joints_rad
        mujoco.mj_forward(model.model, data)
        return data.subtree_com[model.trunk_body].copy()

    empty, loaded = centre(TrotRobot()), centre(TrotRobot(payload_kg=2.5, payload_x_m=0.15, payload_y_m=-0.1))
    assert loaded[:2] == pytest.approx((10 * empty[:2] + 2.5 * np.array([0.15, -0.1])) / 12.5, abs=1e-6)
    assert loaded[2] > empty[2]


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
    targets = joint_targets(robot.plan, np.array([-0.01, 0.01, 0.01, -0.01]), first_pair)
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


def test_starting_with_the_other_pair_mirrors_the_walk(walk):
    other = _walk(1)
    mirror = [1, -1, 1]
    np.testing.assert_allclose(other.position_m, walk.position_m * mirror, atol=1e-9)
    np.testing.assert_allclose(other.rpy_rad, walk.rpy_rad * [-1, 1, -1], atol=1e-8)
    assert np.abs(walk.position_m[:, 1]).max() > 0.005


def test_the_walk_rests_first_and_then_moves_forward(walk):
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
