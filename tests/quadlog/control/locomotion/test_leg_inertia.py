from dataclasses import replace

import mujoco
import numpy as np
import pytest

from quadlog.control.locomotion.leg_dynamics import leg_masses, swing_reaction
from quadlog.control.locomotion.robot import LEGS, ROBOTS, SIDES
from quadlog.simulation.robot.model import mjcf

ROBOT = replace(ROBOTS["foot"], armature_kgm2=0.0)
LEG = pytest.mark.parametrize("leg", [0, 1])


@pytest.fixture(scope="module")
def model():
    """MuJoCo's, with its trunk held."""
    return mujoco.MjModel.from_xml_string(mjcf(ROBOT).replace('<freejoint name="trunk"/>', ""))


def motion(leg, t_s):
    """Joints, rates and accelerations (N, 3) of a swing in all three joints, known in closed form."""
    middle, size = ROBOT.standing_joints_rad[3 * leg : 3 * leg + 3], np.array([0.2, 0.4, -0.5])
    pace = np.array([9.0, 12.0, 15.0])
    angle = np.outer(t_s, pace)
    return middle + size * np.sin(angle), size * pace * np.cos(angle), -size * pace**2 * np.sin(angle)


@LEG
def test_links_lie_where_mujoco_has_them(model, leg):
    data, rng = mujoco.MjData(model), np.random.default_rng(leg)
    postures = rng.uniform([-0.5, -1.5, 0.0], [0.5, 0.5, 2.0], (5, 3))
    masses = leg_masses(ROBOT, SIDES[leg], postures)
    bodies = [model.body(f"{LEGS[leg]}_{link}").id for link in ("abduction", "thigh", "shank")]
    np.testing.assert_allclose(masses.masses_kg, model.body_mass[bodies], atol=1e-15)
    hip = ROBOT.hips_m[leg] + [0, 0, ROBOT.standing_height_m]
    for k, posture in enumerate(postures):
        data.qpos[3 * leg : 3 * leg + 3] = posture
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(masses.centres_m[k], data.xipos[bodies] - hip, atol=1e-15)
        np.testing.assert_allclose(masses.axes[k], data.xaxis[3 * leg : 3 * leg + 3], atol=1e-15)
        turns = data.ximat[bodies].reshape(3, 3, 3)
        inertias = turns @ (model.body_inertia[bodies, :, None] * turns.transpose(0, 2, 1))
        np.testing.assert_allclose(masses.inertias_kgm2[k], inertias, atol=1e-17)


@LEG
@pytest.mark.parametrize("gravity", [9.81, 0.0])
def test_motors_that_mujocos_inverse_dynamics_ask_for_push_back_on_the_body(model, leg, gravity):
    t_s = np.linspace(0.0, 0.4, 801)
    joints, rates, gains = motion(leg, t_s)
    reaction, own = swing_reaction(ROBOT, SIDES[leg], t_s, joints, gravity), slice(3 * leg, 3 * leg + 3)
    axes = leg_masses(ROBOT, SIDES[leg], joints).axes
    data, asked = mujoco.MjData(model), np.empty((len(t_s), 2))
    model.opt.gravity[2] = -gravity
    for k in range(len(t_s)):
        data.qpos[own], data.qvel[own], data.qacc[own] = joints[k], rates[k], gains[k]
        mujoco.mj_inverse(model, data)
        asked[k] = data.qfrc_inverse[own][:2]
    ours = -np.einsum("nki,ni->nk", axes[:, :2], reaction)
    inside = slice(20, -20)  # splines know less of their ends
    assert np.abs(asked).max() > 0.2
    np.testing.assert_allclose(ours[inside], asked[inside], atol=2e-6)
    np.testing.assert_allclose(ours, asked, atol=2e-3)
