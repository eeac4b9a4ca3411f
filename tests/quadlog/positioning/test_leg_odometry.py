from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import joints_for
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.geometry import quat_from_euler, seconds_since
from quadlog.messages import ImuSeries, JointSeries
from quadlog.positioning.leg_odometry import (
    AttitudeSource,
    ContactSource,
    LegGeometry,
    leg_track,
)
from quadlog.simulation.synthetic.recording import IMU_TOPIC, START_NS

ROBOT = ROBOTS["tracking"]
GEOMETRY = LegGeometry(ROBOT.hips_m, ROBOT.lengths_m, ROBOT.foot_radius_m)
SIGNS = np.tile([1.0, -1.0, -1.0], 4)


@pytest.fixture(scope="module")
def joints(walked):
    states = list(walked.site.robot.joint_messages(START_NS, START_NS + round(walked.duration_s * 1e9)))
    columns = ("position_rad", "velocity_radps", "torque_nm", "foot_force_n")
    t_ns = np.array([each.stamp_ns for each in states])
    return JointSeries(t_ns, *(np.array([getattr(each, name) for each in states]) for name in columns))


@pytest.fixture(scope="module")
def imu(walked):
    messages = [message for topic, _, message in walked.messages() if topic == IMU_TOPIC]
    columns = [np.array([getattr(each, name) for each in messages]) for name in ("angular_radps", "quat_xyzw")]
    return ImuSeries(np.array([each.stamp_ns for each in messages]), *columns)


def drift(track, walked):
    """Error at the end as a share of the way, its start and its course over the first metre laid on the true ones."""
    motion = walked.site.robot.at(seconds_since(track.t_ns, START_NS))
    true_m, own_m = motion.position_m - motion.position_m[0], track.position_m[:, :2]
    way_m = np.hypot(*np.diff(true_m[::50], axis=0).T).sum()
    first = np.flatnonzero(np.hypot(*true_m.T) > 1.0)[0]
    to, own = (complex(*each[first]) for each in (true_m, own_m))
    turned = own_m @ np.array([1, 1j]) * (to / own) / abs(to / own)
    return abs(turned[-1] - complex(*true_m[-1])) / way_m


@pytest.mark.parametrize(
    ("without", "source", "limit"),
    [
        ((), ContactSource.FORCE, 0.01),
        (("foot_force_n",), ContactSource.TORQUE, 0.015),
        (("foot_force_n", "torque_nm", "velocity_radps"), ContactSource.HEIGHT, 0.02),
    ],
    ids=["forces", "torques", "angles"],
)
def test_the_way_of_a_simulated_walker_is_found(walked, joints, imu, without, source, limit):
    track = leg_track(replace(joints, **{name: getattr(joints, name) * np.nan for name in without}), GEOMETRY, imu)
    assert drift(track, walked) < limit
    assert track.contact_sources == (source,) * 4
    carries = joints.foot_force_n > 25.0
    assert np.mean((track.contact > 0.5) == carries) > 0.85
    assert track.contact[carries].mean() > 3 * track.contact[joints.foot_force_n == 0].mean()
    assert track.attitude is AttitudeSource.IMU
    assert track.unheld_s < 0.1


def test_feet_stand_while_a_robot_stands_that_trotted_a_little():
    t_ns = START_NS + np.arange(2000) * 10_000_000
    swings = np.sin(2 * np.pi * (np.arange(2000)[:, None] / 40 + [0.0, 0.5, 0.5, 0.0])) > 0.2
    trots = np.arange(2000)[:, None] > 1780
    force_n = np.where(trots, np.where(swings, 0.0, 75.0), 30.0)
    force_n += np.random.default_rng(0).normal(size=force_n.shape)
    position_rad, unknown = np.tile([0.0, 0.8, -1.6], (2000, 4)), np.full((2000, 12), np.nan)
    track = leg_track(JointSeries(t_ns, position_rad, unknown, unknown, force_n), GEOMETRY)
    assert track.unheld_s < 0.1
    assert track.contact[:1700].min() > 0.5
    lands = track.contact[1800:] > 0.5
    assert (lands == ~swings[1800:]).mean() > 0.9


def test_without_an_attitude_rates_give_the_turns_and_without_an_imu_the_feet_do(walked, joints, imu):
    true_rad = np.unwrap(walked.site.robot.at(seconds_since(joints.t_ns, START_NS)).yaw_rad)
    for known, source in ((replace(imu, quat_xyzw=None), AttitudeSource.GYRO), (None, AttitudeSource.FEET)):
        track = leg_track(joints, GEOMETRY, known)
        assert track.attitude is source
        assert drift(track, walked) < 0.03
        turned = track.rpy_rad[:, 2] - track.rpy_rad[0, 2] - (true_rad - true_rad[0])
        assert np.abs(turned).max() < np.radians(4.0)


def test_a_leg_without_forces_has_its_torques_and_nan_torques_are_no_contact_of_their_own(walked, joints, imu):
    force_n, torque_nm = joints.foot_force_n.copy(), joints.torque_nm.copy()
    force_n[:, 2], torque_nm[::3] = np.nan, np.nan
    track = leg_track(replace(joints, foot_force_n=force_n, torque_nm=torque_nm), GEOMETRY, imu)
    assert track.contact_sources[::2] == (ContactSource.FORCE, ContactSource.TORQUE)
    assert np.isfinite(track.contact).all()
    assert drift(track, walked) < 0.015


def test_a_leg_without_angles_is_out_and_without_any_foot_the_speed_is_held_for_a_while(walked, joints, imu):
    position_rad = joints.position_rad.copy()
    position_rad[1000:2000, :3] = np.nan
    one = leg_track(replace(joints, position_rad=position_rad), GEOMETRY, imu)
    assert not one.contact[1000:1999, 0].any()
    assert drift(one, walked) < 0.02
    position_rad[3000:3500] = np.nan
    none = leg_track(replace(joints, position_rad=position_rad), GEOMETRY, imu)
    assert none.unheld_s == pytest.approx(1.0, abs=0.02)
    held_m = np.hypot(*(none.position_m[3499] - none.position_m[3000])[:2])
    assert held_m == pytest.approx(0.3 * 0.7, abs=0.06)
    kept = np.delete(np.arange(len(joints)), slice(3000, 3100))
    gap = leg_track(JointSeries(*(getattr(joints, of.name)[kept] for of in fields(joints))), GEOMETRY, imu)
    assert drift(gap, walked) < 0.03


def test_an_empty_series_is_an_empty_track():
    empty = JointSeries(np.empty(0, np.int64), *(np.empty((0, width)) for width in (12, 12, 12, 4)))
    assert len(leg_track(empty, GEOMETRY)) == 0
    one = JointSeries(np.zeros(1, np.int64), np.zeros((1, 12)), *(np.full((1, width), np.nan) for width in (12, 12, 4)))
    np.testing.assert_array_equal(leg_track(one, GEOMETRY).position_m, np.zeros((1, 3)))


waves = st.tuples(*(st.floats(-1, 1) for _ in range(12)))


@given(waves)
def test_feet_fixed_in_the_world_give_back_any_motion_of_the_body_exactly(wave):
    t_s = np.arange(0.0, 1.0, 0.005)
    amplitude = np.array([0.05, 0.04, 0.03, 0.1, 0.1, 0.2])
    shares, phases = np.array(wave[:6]), np.pi * np.array(wave[6:])
    x, y, z, roll, pitch, yaw = amplitude[:, None] * shares[:, None] * np.sin(3.0 * t_s + phases[:, None])
    turns = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    place_m = np.column_stack([x, y, z])
    angles = np.empty((len(t_s), 12))
    for k, (turn, at_m) in enumerate(zip(turns, place_m, strict=True)):
        reached = joints_for(turn.inv().apply(ROBOT.standing_feet_m - at_m), ROBOT.hips_m, ROBOT.lengths, angles[k])
        assert reached
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    unknown = np.full((len(t_s), 12), np.nan)
    joints = JointSeries(t_ns, angles * SIGNS, unknown, unknown, np.full((len(t_s), 4), 30.0))
    imu = ImuSeries(t_ns, np.zeros((len(t_s), 3)), quat_from_euler(yaw, pitch, roll) + 0.0)
    if np.ptp(imu.quat_xyzw, axis=0).any():  # one that never changes is a driver's default
        track = leg_track(joints, replace(GEOMETRY, foot_radius_m=0.0), imu)
        np.testing.assert_allclose(track.position_m, place_m - place_m[0], atol=1e-9)
        assert track.contact.min() > 0.95
