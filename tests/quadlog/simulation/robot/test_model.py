from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.simulation.robot.height_field import Extent, HeightField, flat, s_course, slope, undulating
from quadlog.simulation.robot.model import QuadrupedModel, quadruped_model

ROBOT = ROBOTS["tracking"]
LINKS = ("abduction", "thigh", "shank")
NEAR = Extent(-1.0, -1.0, 2.0, 2.0)
robots = pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))


def somewhere(quadruped: QuadrupedModel, seed: int) -> tuple[mujoco.MjData, np.ndarray]:
    """A pose in the air with joints of its own, and them."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(quadruped.model)
    joints = quadruped.robot.standing_joints_rad + rng.uniform(-0.5, 0.5, 12)
    data.qpos[:3] = rng.uniform([-1, -1, 2], [1, 1, 4])
    data.qpos[3:7] = Rotation.from_rotvec(rng.uniform(-1, 1, 3)).as_quat()[[3, 0, 1, 2]]
    data.qpos[quadruped.joint_qpos] = joints
    mujoco.mj_forward(quadruped.model, data)
    return data, joints


def stand(quadruped: QuadrupedModel, qpos: np.ndarray, seconds: float) -> tuple[mujoco.MjData, np.ndarray]:
    """The robot held in qpos's joints by springs; also the feet's positions every step."""
    data = mujoco.MjData(quadruped.model)
    data.qpos[:] = qpos
    feet = []
    for _ in range(round(seconds / quadruped.model.opt.timestep)):
        off = qpos[quadruped.joint_qpos] - data.qpos[quadruped.joint_qpos]
        data.ctrl[:] = 400 * off - 8 * data.qvel[quadruped.joint_qvel]
        mujoco.mj_step(quadruped.model, data)
        feet.append(data.site_xpos[quadruped.foot_sites].copy())
    return data, np.array(feet)


@robots
def test_mass_and_inertia_of_a_robot_are_the_sums_over_its_links(robot):
    quadruped = quadruped_model(robot, flat())
    model, data, known = quadruped.model, mujoco.MjData(quadruped.model), quadruped.robot
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    data.qpos[quadruped.joint_qpos] = robot.standing_joints_rad
    mujoco.mj_forward(model, data)
    masses, turns = model.body_mass, data.ximat.reshape(-1, 3, 3)
    assert masses.sum() == pytest.approx(robot.mass_kg, abs=1e-12)
    np.testing.assert_allclose(known.centre_of_mass_m, masses @ data.xipos / masses.sum(), atol=1e-15)
    arms = data.xipos - known.centre_of_mass_m
    apart = (masses * (arms**2).sum(axis=1)).sum() * np.eye(3) - (arms.T * masses) @ arms
    own = (turns * model.body_inertia[:, None] @ turns.transpose(0, 2, 1)).sum(axis=0)
    np.testing.assert_allclose(known.inertia_kgm2, own + apart, atol=1e-14)
    small, middle, large = np.linalg.eigvalsh(known.inertia_kgm2)
    assert 0 < small < middle < large < small + middle


def test_links_are_even_balls_and_rods():
    """By hand, of [Tracking]'s robot: a ball, a rod that hangs 15 % below the hip, a rod with a ball at its end."""
    model = quadruped_model(ROBOT, flat()).model
    trunk, abduction, thigh, shank = (model.body(f"{name}") for name in ("trunk", *(f"right_fore_{k}" for k in LINKS)))
    np.testing.assert_allclose(trunk.inertia, 6.01 / 12 * np.array([0.050632, 0.084285, 0.108925]), rtol=1e-12)
    np.testing.assert_allclose(abduction.ipos, [0, -0.0375, 0], atol=1e-15)
    np.testing.assert_allclose(abduction.inertia, 0.4 * 0.595 * 0.045**2, rtol=1e-12)
    np.testing.assert_allclose(thigh.ipos, [0, 0, -0.033], atol=1e-15)
    across = 0.888 * (3 * 0.045**2 + 0.22**2) / 12
    np.testing.assert_allclose(thigh.inertia, [across, across, 0.888 * 0.045**2 / 2], rtol=1e-12)
    below = (0.151 * 0.11 + 0.06 * 0.22) / 0.211
    np.testing.assert_allclose([shank.mass[0], *shank.ipos], [0.211, 0, 0, -below], atol=1e-15)
    across = 0.151 * (3 * 0.012**2 + 0.22**2) / 12 + 0.4 * 0.06 * 0.02**2
    across += 0.151 * (0.11 - below) ** 2 + 0.06 * (0.22 - below) ** 2
    np.testing.assert_allclose(shank.inertia, [across, across, 0.151 * 0.012**2 / 2 + 0.4 * 0.06 * 0.02**2], rtol=1e-12)


@pytest.mark.parametrize("name", ["go1", "go2", "a1", "b1"])
def test_trunks_are_as_their_maker_prints_them_where_it_does(name):
    robot = ROBOTS[name]
    trunk = quadruped_model(robot, flat()).model.body("trunk")
    turn = Rotation.from_quat(np.roll(trunk.iquat, -1)).as_matrix()
    xx, yy, zz, xy, xz, yz = robot.trunk_inertia_kgm2
    printed = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    np.testing.assert_allclose(turn @ np.diag(trunk.inertia) @ turn.T, printed, atol=1e-12)
    np.testing.assert_array_equal(trunk.ipos, robot.trunk_centre_m)
    assert trunk.mass == robot.trunk_mass_kg


@robots
def test_feet_are_where_our_kinematics_have_them(robot):
    quadruped = quadruped_model(robot, flat())
    for seed in range(5):
        data, joints = somewhere(quadruped, seed)
        feet = np.empty((4, 3))
        foot_positions(joints, robot.hips_m, robot.lengths, feet)
        rotation = data.xmat[quadruped.trunk_body].reshape(3, 3)
        expected = feet @ rotation.T + data.qpos[:3]
        np.testing.assert_allclose(data.site_xpos[quadruped.foot_sites], expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.geom_xpos[quadruped.foot_geoms], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "ground",
    [flat(), undulating(0.06, seed=2, extent=NEAR)],
    ids=["flat", "6cm"],
)
@robots
def test_it_stands_still(robot, ground: HeightField):
    quadruped = quadruped_model(robot, ground)
    qpos = quadruped.standing_at(0.4, 0.5, 0.3)
    data, feet = stand(quadruped, qpos, 2.0)
    assert abs(data.qpos[2] - qpos[2]) < 0.06 * robot.standing_height_m
    settled = feet[len(feet) // 4 :]
    assert np.ptp(settled, axis=0).max() < 0.01 * robot.standing_height_m
    assert data.xmat[quadruped.trunk_body][8] > 0.99
    touching = {int(geom) for geom in data.contact.geom.ravel()}
    assert touching == {quadruped.model.geom("ground").id, *quadruped.foot_geoms.tolist()}


@pytest.mark.parametrize(
    "ground",
    [flat(), slope(0.25, 0.4), undulating(0.06, seed=4), s_course(seed=1)],
    ids=["flat", "slope", "6cm", "s-course"],
)
def test_it_starts_just_above_the_ground(ground: HeightField):
    quadruped = quadruped_model(ROBOT, ground)
    for x_m, yaw_rad in [(0.0, 0.0), (3.0, 0.7), (1.3, -2.0)]:
        data = mujoco.MjData(quadruped.model)
        data.qpos[:] = quadruped.standing_at(x_m, 0.4, yaw_rad)
        mujoco.mj_forward(quadruped.model, data)
        assert min(data.contact.dist, default=0.0) >= 0
        feet = data.site_xpos[quadruped.foot_sites]
        above = feet[:, 2] - ground.height_at(feet[:, :2])
        assert (above >= ROBOT.foot_radius_m - 1e-6).all()
        assert (above <= ROBOT.foot_radius_m + 0.004).all()


def test_a_foot_slides_where_the_friction_is_too_low():
    incline = slope(math.radians(25))
    for friction, slides in [(0.3, True), (0.8, False)]:
        quadruped = quadruped_model(ROBOT, incline, friction=friction)
        _, feet = stand(quadruped, quadruped.standing_at(0.0, 0.0), 1.0)
        assert (np.abs(feet[-1] - feet[0]).max() > 0.1) == slides
