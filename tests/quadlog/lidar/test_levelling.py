from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.lidar.levelling import NotLevelled, UpSeries, level_rotations, up_in_base

MS = 1_000_000
T_NS = 1_767_225_600_000_000_000
tilt = st.floats(-0.45, 0.45)
heading = st.floats(-3.1, 3.1)


def series(*yaw_pitch_roll) -> UpSeries:
    """Orientations 10 ms apart from T_NS on."""
    quat_xyzw = Rotation.from_euler("ZYX", yaw_pitch_roll).as_quat()
    return up_in_base(T_NS + np.arange(len(yaw_pitch_roll)) * 10 * MS, quat_xyzw)


def at(*ms: float) -> np.ndarray:
    return T_NS + np.array([round(each * MS) for each in ms], dtype=np.int64)


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
    """Also between samples of a body that sways, whichever of its two signs a quaternion has."""
    imu_to_base = Rotation.from_euler("ZYX", [mount_yaw, mount_pitch, mount_roll])
    known_ms, wanted_ms = np.arange(0, 200, 10), np.array([0, 13, 55, 190])
    sway = np.cos(known_ms / 200)
    base_to_world = Rotation.from_euler("ZYX", np.column_stack([yaw + known_ms / 1000, pitch * sway, roll * sway]))
    quat_xyzw = (base_to_world * imu_to_base).as_quat() * np.where(known_ms % 20 > 0, sign, 1)[:, None]
    rotations, why = level_rotations(at(*wanted_ms), up_in_base(at(*known_ms), quat_xyzw, imu_to_base.as_matrix()))
    truth = Rotation.from_euler("YX", np.outer(np.cos(wanted_ms / 200), [pitch, roll])).as_matrix()
    assert why is None
    np.testing.assert_allclose(rotations, truth, atol=3e-4)
    np.testing.assert_allclose(rotations[[0, 3]], truth[[0, 3]], atol=1e-9)
