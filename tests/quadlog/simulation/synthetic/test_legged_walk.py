from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.robot import ROBOTS
from quadlog.errors import QuadlogError
from quadlog.messages import JointStates
from quadlog.simulation.robot.height_field import slope
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.legged_walk import LeggedWalk
from quadlog.simulation.synthetic.recording import (
    IMU_TOPIC,
    JOINT_TOPIC,
    ROBOT_TRUTH_TOPIC,
)

ROBOT = ROBOTS["tracking"]


@pytest.fixture(scope="module")
def by_topic(walked):
    topics: dict[str, list] = {}
    for topic, _, message in walked.messages():
        topics.setdefault(topic, []).append(message)
    return topics


def feet_in_trunk(joints: JointStates) -> np.ndarray:
    """(4, 3) by a chain of rotations, as a URDF of Unitree's describes it."""
    aside, thigh, calf = ROBOT.lengths_m
    feet = []
    for leg, (hip, q) in enumerate(zip(ROBOT.hips_m, joints.position_rad.reshape(4, 3), strict=True)):
        first, second, third = (
            Rotation.from_rotvec(axis) for axis in (q[0] * np.eye(3)[0], q[1] * np.eye(3)[1], q[2] * np.eye(3)[1])
        )
        below = second.apply([0.0, 0.0, -thigh]) + (second * third).apply([0.0, 0.0, -calf])
        feet.append(hip + first.apply(np.array([0.0, (1, -1, 1, -1)[leg] * aside, 0.0]) + below))
    return np.array(feet)


def test_feet_that_carry_stand_on_the_ground_where_the_true_poses_put_them(by_topic):
    joints = {each.stamp_ns: each for each in by_topic[JOINT_TOPIC]}
    before: np.ndarray | None = None
    steps_m, heights_m = [], []
    for pose in by_topic[ROBOT_TRUTH_TOPIC]:
        state, turn = joints[pose.stamp_ns], Rotation.from_quat(pose.quat_xyzw)
        trunk_m = pose.position_m + turn.apply([0.0, 0.0, ROBOT.standing_height_m])
        feet_m = np.where(state.foot_force_n[:, None] > 20.0, trunk_m + turn.apply(feet_in_trunk(state)), np.nan)
        heights_m.append(feet_m[:, 2])
        if before is not None:
            steps_m.append(np.linalg.norm(feet_m - before, axis=1))
        before = feet_m
    # In 20 ms a body makes 14 mm; a ball of 2 cm rolls, and sinks in a little.
    assert np.nanmedian(steps_m) < 0.0025
    np.testing.assert_allclose(np.nanmedian(heights_m), ROBOT.foot_radius_m, atol=0.004)
    assert np.nanpercentile(heights_m, 99) < ROBOT.foot_radius_m + 0.003


def test_feet_carry_the_robot_and_torques_push_them_down(by_topic):
    states = by_topic[JOINT_TOPIC][500:]
    total_n = np.mean([each.foot_force_n.sum() for each in states])
    assert total_n == pytest.approx(ROBOT.mass_kg * 9.81, rel=0.02)
    # A calf's torque that carries a robot turns it forward, against its own angle.
    calves = np.array([each.torque_nm[2::3] for each in states])
    loaded = np.array([each.foot_force_n for each in states]) > 40.0
    assert calves[loaded].mean() > 2.0


def test_the_imu_measures_how_the_true_poses_turn_and_what_feet_push(by_topic):
    poses, imu = by_topic[ROBOT_TRUTH_TOPIC], by_topic[IMU_TOPIC]
    turns = Rotation.from_quat([each.quat_xyzw for each in poses])
    true_radps = (turns[:-1].inv() * turns[1:]).as_rotvec() / 0.02
    gyro = {each.stamp_ns: each.angular_radps for each in imu}
    between = np.array([gyro[each.stamp_ns + 10_000_000] for each in poses[:-1]])
    assert np.abs(np.median(between - true_radps, axis=0)).max() < 0.01
    for axis in range(3):
        assert np.corrcoef(between[:, axis], true_radps[:, axis])[0, 1] > 0.9
    felt_mps2 = np.mean([each.linear_mps2 for each in imu[100:]], axis=0)
    assert felt_mps2[2] == pytest.approx(9.81, abs=0.1)


def test_a_walker_that_falls_says_when_and_where():
    walk = LeggedWalk(follow.synthesize(0, 5.0, 16).site.robot, 5.0, slope(np.radians(50.0)))
    with pytest.raises(QuadlogError, match=r"fell after \d\.\d s at \(.*--seed"):
        walk.at(np.zeros(1))
