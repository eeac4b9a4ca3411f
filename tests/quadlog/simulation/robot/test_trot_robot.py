from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from quadlog.control.locomotion.robot import LEGS, SIDES
from quadlog.simulation.robot.trot import (
    HEIGHT_M,
    TrotRobot,
    gravity_moment_nm,
    hip_inertia_kgm2,
    start_qpos,
    trot_model,
)

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


def test_it_weighs_what_the_paper_says():
    model = trot_model(TrotRobot())
    assert model.model.body_subtreemass[0] == pytest.approx(10, abs=1e-5)
    assert _leg_masses(TrotRobot()) == pytest.approx(LEG_KG, abs=1e-5)


def test_gravity_tips_it_by_eq_8():
    """M about x with M = 4 m, d of even rods: half as far behind as the knee, for thigh and shank alike."""
    behind, _ = _knee()
    moment = 4 * LEG_KG * 9.81 * behind / 2
    length, width = 0.36, 0.12 + 2 * ASIDE_M
    expected = -moment * length * width / (length**2 + width**2)
    assert gravity_moment_nm(trot_model(TrotRobot())) == pytest.approx(expected, rel=1e-4)


def test_a_leg_turns_about_its_hip_as_two_rods_do():
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


def test_hips_are_off_against_one_another():
    straight, off = (trot_model(TrotRobot(hip_offset_m=offset)) for offset in (0.0, 0.005))
    moved = (off.model.body_pos - straight.model.body_pos)[_bodies(off, "abduction")]
    np.testing.assert_allclose(moved, np.column_stack([0.005 * SIDES, np.zeros(4), np.zeros(4)]), atol=1e-15)


def test_friction_and_feet_are_those_asked_for():
    model = trot_model(TrotRobot(friction=0.55, foot_radius_m=0.018))
    assert model.model.geom_friction[[*model.foot_geoms, model.ground_geom], 0] == pytest.approx(0.55)
    assert model.model.geom_size[model.foot_geoms, 0] == pytest.approx(0.018)


def test_motors_hold_angles():
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
