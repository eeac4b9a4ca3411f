from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.control.locomotion.robot import LEGS, ROBOTS, SIDES
from quadlog.messages import Float
from quadlog.results.tables import TABLES
from quadlog.simulation.robot.trot import (
    HEIGHT_M,
    LIFT_M,
    PAIRS,
    SAMPLES_HZ,
    STEP_M,
    OutOfReach,
    TrotRobot,
    TrotWalk,
    draw_trot,
    gravity_moment_nm,
    hip_inertia_kgm2,
    joint_targets,
    sampled,
    start_qpos,
    trot_model,
    walk_trot,
)

ROBOT = ROBOTS["foot"]


@given(st.integers(0, 2**31 - 1))
def test_draws_lie_within_their_spreads_and_repeat_for_a_seed(seed):
    draw, again = (draw_trot(seed, 0.25, 0.1, 0.02) for _ in range(2))
    assert abs(draw.friction_share) <= 0.25
    assert abs(draw.radius_share) <= 0.1
    assert np.abs(draw.postures_rad).max() <= 0.02
    assert (draw.friction_share, draw.radius_share) == (again.friction_share, again.radius_share)
    np.testing.assert_array_equal(draw.postures_rad, again.postures_rad)


def test_draws_cover_their_spreads():
    draws = [draw_trot(seed, 0.25, 0.1, 0.02) for seed in range(200)]
    friction, radius = (
        np.array([getattr(draw, name) for draw in draws]) for name in ("friction_share", "radius_share")
    )
    postures = np.array([draw.postures_rad for draw in draws])
    for values, spread in ((friction, 0.25), (radius, 0.1), (postures, 0.02)):
        assert abs(values.mean()) < 0.15 * spread
        assert values.max() > 0.95 * spread
        assert values.min() < -0.95 * spread


def test_the_other_pair_starts_from_the_mirrored_posture():
    draw = draw_trot(5, 0.25, 0.1, 0.02)
    feet = np.empty((2, 4, 3))
    for pair in (0, 1):
        foot_positions(ROBOT.standing_joints_rad + draw.of_pair(pair), ROBOT.hips_m, ROBOT.lengths, feet[pair])
    np.testing.assert_allclose(feet[1], feet[0, [1, 0, 3, 2]] * [1, -1, 1], atol=1e-15)
    assert not np.allclose(feet[1], feet[0])


LINK_M, ASIDE_M, LEG_KG = 0.21, 0.07, 0.4


def _bodies(model, name: str) -> list[int]:
    return [mujoco.mj_name2id(model.model, mujoco.mjtObj.mjOBJ_BODY, f"{leg}_{name}") for leg in LEGS]


def _leg_masses(robot: TrotRobot) -> np.ndarray:
    model = trot_model(robot)
    return model.model.body_subtreemass[_bodies(model, "abduction")]


def _knee() -> tuple[float, float]:
    """How far the knee is behind and below the hip: thigh and shank are as long as one another."""
    down = (HEIGHT_M - 0.02) / 2
    return math.sqrt(LINK_M**2 - down**2), down


def test_masses_are_those_of_the_paper():
    model = trot_model(TrotRobot())
    assert model.model.body_subtreemass[0] == pytest.approx(10, abs=1e-5)
    assert _leg_masses(TrotRobot()) == pytest.approx(LEG_KG, abs=1e-5)


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


def test_left_legs_are_heavier_by_the_spread_and_right_ones_lighter():
    assert _leg_masses(TrotRobot(leg_mass_spread=0.1)) == pytest.approx(LEG_KG * (1 + 0.1 * SIDES), abs=1e-5)


def test_the_hip_offset_moves_left_hips_forward_and_right_ones_back():
    straight, off = (trot_model(TrotRobot(hip_offset_m=offset)) for offset in (0.0, 0.005))
    moved = (off.model.body_pos - straight.model.body_pos)[_bodies(off, "abduction")]
    np.testing.assert_allclose(moved, np.column_stack([0.005 * SIDES, np.zeros(4), np.zeros(4)]), atol=1e-15)


def test_friction_and_foot_radius_are_those_of_the_settings():
    model = trot_model(TrotRobot(friction=0.55, foot_radius_m=0.018))
    assert model.model.geom_friction[[*model.foot_geoms, model.ground_geom], 0] == pytest.approx(0.55)
    assert model.model.geom_size[model.foot_geoms, 0] == pytest.approx(0.018)


def test_motors_are_position_servos():
    """kp 300, kv 6: the torque at a joint that is off and moves."""
    model = trot_model(TrotRobot())
    data = mujoco.MjData(model.model)
    data.qpos[2] = 5.0
    data.qpos[model.joint_qpos[4]], data.qvel[model.joint_qvel[4]] = 0.5, 0.25
    data.ctrl[model.actuators[4]] = 0.53
    mujoco.mj_forward(model.model, data)
    assert data.sensordata[model.actuators[4]] == pytest.approx(300 * 0.03 - 6 * 0.25)


def test_it_starts_with_its_lowest_foot_just_on_the_ground():
    model = trot_model(TrotRobot(foot_radius_m=0.022))
    joints = model.robot.standing_joints_rad + np.linspace(-0.02, 0.02, 12)
    data = mujoco.MjData(model.model)
    data.qpos[:] = start_qpos(model, joints)
    mujoco.mj_forward(model.model, data)
    assert data.site_xpos[model.foot_sites, 2].min() - 0.022 == pytest.approx(1e-4)
    np.testing.assert_array_equal(data.qpos[model.joint_qpos], joints)
    assert data.ncon == 0 or min(data.contact.dist) > 0


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


def test_the_fallen_flag_is_latched():
    model = trot_model(TrotRobot())
    world = model.model
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.zeros((1000, mujoco.mj_stateSize(world, full)))
    states[:, 3], states[:, 4] = 0.2, 1.0
    states[400:600, 3] = 0.05
    fallen = sampled(model, states[0], states, np.zeros((1000, world.nsensordata))).fallen
    np.testing.assert_array_equal(fallen, np.arange(51) >= 21)


def test_a_heavy_load_ahead_makes_the_robot_fall():
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
