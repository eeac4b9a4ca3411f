from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.lidar.levelling import NotLevelled, UpSeries, level_rotations, up_in_base
from quadlog.simulation.synthetic import forest
from quadlog.simulation.synthetic.recording import IMU_TOPIC, START_NS

MS = 1_000_000
T_NS = 1_767_225_600_000_000_000
tilt = st.floats(-0.45, 0.45)
heading = st.floats(-3.1, 3.1)


def quats(*yaw_pitch_roll) -> np.ndarray:
    return Rotation.from_euler("ZYX", np.atleast_2d(yaw_pitch_roll)).as_quat()


def series(*yaw_pitch_roll, step_ms: int = 10) -> UpSeries:
    """Orientations from T_NS on."""
    return up_in_base(T_NS + np.arange(len(yaw_pitch_roll)) * step_ms * MS, quats(*yaw_pitch_roll))


def at(*ms: float) -> np.ndarray:
    return T_NS + np.array([round(each * MS) for each in ms], dtype=np.int64)


def test_the_imu_of_a_simulated_walk_over_rough_ground_levels_it():
    recording = forest.synthesize(seed=3, duration_s=1.0, azimuth_steps=16)
    imu = [each.message for each in recording.messages() if each.topic == IMU_TOPIC]
    known = up_in_base(np.array([each.stamp_ns for each in imu]), np.array([each.quat_xyzw for each in imu]))
    wanted = START_NS + np.arange(103, 900, 97) * MS
    rotations, why = level_rotations(wanted, known)
    assert why is None
    motion = recording.site.robot.at((wanted - START_NS) * 1e-9)
    truth = Rotation.from_euler("YX", np.column_stack([motion.pitch_rad, motion.roll_rad])).as_matrix()
    assert np.abs(motion.pitch_rad).max() > 0.01
    np.testing.assert_allclose(rotations, truth, atol=2e-3)


STALE, STEEP = NotLevelled.STALE, NotLevelled.STEEP
STILL, NOTHING = [[0, 0.2, 0]] * 42, np.array([[np.nan] * 4, [0.0] * 4, [np.inf, 0, 0, 1]])


@pytest.mark.parametrize(
    ("ms", "known", "why"),
    [
        ((0,), series(*STILL), None), ((-200, 0), series(*STILL), None), ((-200.001,), series(*STILL), STALE),
        ((610,), series(*STILL), None), ((0, 610.001), series(*STILL), STALE),
        ((0, 1), up_in_base(at(0, 1, 2), NOTHING), STALE),
        *(((0,), series([0.5, 0.0, np.radians(each)]), None) for each in (39.9, -39.9)),
        *(((0,), series([0.5, 0.0, np.radians(each)]), STEEP) for each in (40.1, 90, 180)),
        ((0, 10, 20), series([0, 0.1, 0], [0, 0.2, 0], [0, 1.2, 0]), STEEP),
    ],
)  # fmt: skip
def test_a_scan_is_levelled_as_a_whole_by_what_is_known_and_plausible_or_not_at_all(ms, known, why):
    rotations, found = level_rotations(at(*ms), known)
    assert found is why
    assert rotations.shape == (len(ms), 3, 3)
    assert np.allclose(rotations, np.eye(3)) == (why is not None)


@given(tilt, tilt, heading, heading, st.floats(-1.4, 1.4), heading, st.sampled_from([1, -1]))
def test_the_tilt_of_base_is_taken_out_whatever_the_heading_and_mount(
    pitch, roll, yaw, mount_yaw, mount_pitch, mount_roll, sign
):
    imu_to_base = Rotation.from_euler("ZYX", [mount_yaw, mount_pitch, mount_roll])
    imu_to_world = Rotation.from_euler("ZYX", [yaw, pitch, roll]) * imu_to_base
    known = up_in_base(at(0), sign * imu_to_world.as_quat()[None], imu_to_base.as_matrix())
    rotations, why = level_rotations(at(0), known)
    assert why is None
    np.testing.assert_allclose(rotations[0], Rotation.from_euler("YX", [pitch, roll]).as_matrix(), atol=1e-9)
