from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.messages import Imu, Odometry, Pose
from quadlog.simulation.robot.height_field import slope
from quadlog.simulation.sensors.imu import ImuErrors, imu_messages
from quadlog.simulation.sensors.trajectory import ROBOT_FEET_M, OnTerrain, Route, RouteWalk
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import IMU_TOPIC, ODOMETRY_TOPIC, ROBOT_TRUTH_TOPIC, START_NS


@pytest.fixture(scope="module")
def recording():
    return follow.synthesize(seed=2, duration_s=20.0, azimuth_steps=16)


@pytest.fixture(scope="module")
def by_topic(recording):
    topics: dict[str, list] = {}
    for topic, _, message in recording.messages():
        topics.setdefault(topic, []).append(message)
    return topics


def yaw(quats):
    return np.unwrap(Rotation.from_quat(quats).as_euler("zyx")[:, 0])


def truth(by_topic):
    poses = [each for each in by_topic[ROBOT_TRUTH_TOPIC] if isinstance(each, Pose)]
    t_s = np.array([each.stamp_ns - poses[0].stamp_ns for each in poses]) * 1e-9
    return t_s, np.array([each.position_m for each in poses]), yaw([each.quat_xyzw for each in poses])


def imu(by_topic) -> list[Imu]:
    return by_topic[IMU_TOPIC]


def odometry(by_topic) -> list[Odometry]:
    return by_topic[ODOMETRY_TOPIC]


def test_gyro_is_the_rate_of_the_true_yaw(by_topic):
    t_s, _, true_yaw = truth(by_topic)
    rate = np.gradient(true_yaw, t_s)
    gyro = np.array([each.angular_radps for each in imu(by_topic)])[::2]
    error = gyro[:, 2] - rate
    assert error.std() == pytest.approx(0.01, rel=0.1)
    assert error.mean() == pytest.approx(0.002, abs=0.001)
    assert np.abs(rate).max() > 0.5


def test_imu_yaw_is_the_true_yaw_with_offset_and_drift(recording, by_topic):
    t_s, _, true_yaw = truth(by_topic)
    difference = yaw([each.quat_xyzw for each in imu(by_topic)][::2]) - true_yaw
    drift, offset = np.polyfit(t_s, difference, 1)
    assert np.angle(np.exp(1j * (offset - recording.imu_errors.yaw_offset_rad))) == pytest.approx(0, abs=1e-3)
    assert drift == pytest.approx(0.0005, abs=5e-5)
    assert np.std(difference - np.polyval([drift, offset], t_s)) == pytest.approx(0.002, rel=0.1)


def test_accelerometer_is_the_second_derivative_of_the_true_position_and_gravity(by_topic):
    t_s, position, true_yaw = truth(by_topic)
    velocity = np.gradient(position[:, :2], t_s, axis=0)
    acceleration = np.gradient(velocity, t_s, axis=0)
    in_base = (acceleration[:, 0] + 1j * acceleration[:, 1]) * np.exp(-1j * true_yaw)
    measured = np.array([each.linear_mps2 for each in imu(by_topic)])[::2]
    inner = slice(5, -5)
    for error in (measured[:, 0] - in_base.real, measured[:, 1] - in_base.imag, measured[:, 2] - 9.81):
        assert error[inner].mean() == pytest.approx(0, abs=0.01)
        assert error[inner].std() == pytest.approx(0.1, rel=0.1)


def test_odometry_starts_at_its_own_origin_and_drifts(by_topic):
    _, position, true_yaw = truth(by_topic)
    messages = odometry(by_topic)
    place = np.array([each.position_m for each in messages])
    np.testing.assert_allclose(place[0], 0, atol=1e-12)
    start = Rotation.from_euler("z", true_yaw[0])
    error = np.linalg.norm((start.apply(place) + position[0] - position)[:, :2], axis=1)
    assert error[50] < 0.05
    assert 0.2 < error[-1] < 3.0
    walked = np.linalg.norm(np.diff(place, axis=0), axis=1).sum()
    true_walked = np.linalg.norm(np.diff(position, axis=0), axis=1).sum()
    assert walked / true_walked == pytest.approx(1.015, abs=0.005)
    turned = yaw([each.quat_xyzw for each in messages])
    assert (turned[-1] - turned[0]) - (true_yaw[-1] - true_yaw[0]) == pytest.approx(0.06, abs=0.03)


def silent_readings(walk):
    t_ns = START_NS + np.arange(0, 20_000_000_000, 10_000_000)
    silent = ImuErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    readings = list(imu_messages(silent, walk, START_NS, t_ns, np.random.default_rng(0)))
    attitude = Rotation.from_quat([each.quat_xyzw for each in readings])
    turn_radps = (attitude[:-2].inv() * attitude[2:]).as_rotvec() / 0.02
    return attitude, turn_radps, readings


def test_round_a_circle_on_a_slope_the_gyro_turns_about_its_normal_and_gravity_stays_upright():
    angle = 2 * np.pi * np.arange(40) / 40
    circle = Route(3.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    walk = OnTerrain(RouteWalk(circle, 0.0, 0.8, 0.0, 10.0), slope(0.3), ROBOT_FEET_M)
    attitude, turn_radps, readings = silent_readings(walk)
    gyro = np.array([each.angular_radps for each in readings])[1:-1]
    np.testing.assert_allclose(gyro[:, :2], 0.0, atol=1e-4)
    np.testing.assert_allclose(gyro, turn_radps, atol=2e-3)
    force = attitude.apply([each.linear_mps2 for each in readings])
    np.testing.assert_allclose(force[:, 2], 9.81, atol=1e-9)
    np.testing.assert_allclose(np.hypot(force[:, 0], force[:, 1]), 0.8**2 / 3.0, atol=2e-3)
