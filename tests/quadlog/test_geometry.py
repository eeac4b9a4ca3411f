"""Rotations against scipy's."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from quadlog.geometry import rotation_from_quat, transform_from_quat, transform_from_rpy

numbers = st.floats(-1e3, 1e3).map(lambda x: round(x, 3))


@settings(deadline=None)
@given(arrays(float, (5, 4), elements=numbers).filter(lambda quat: (np.abs(quat).max(axis=1) > 0).all()))
def test_rotations_of_quaternions_of_any_length(quat):
    np.testing.assert_allclose(rotation_from_quat(quat), Rotation.from_quat(quat).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(transform_from_quat(np.ones(3), quat[0])[:3, :3], rotation_from_quat(quat[0]))


@settings(deadline=None)
@given(st.tuples(*[st.floats(-7, 7)] * 3))
def test_roll_pitch_and_yaw_turn_in_this_order(rpy):
    got = transform_from_rpy(np.array([1.0, 2.0, 3.0]), *rpy)
    np.testing.assert_allclose(got[:3, :3], Rotation.from_euler("ZYX", rpy[::-1]).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(got[:, 3], [1, 2, 3, 1])


def test_a_replay_does_not_wait_for_scipy_spatial():
    code = "import sys, quadlog.pipelines.stages.warm_up; sys.exit('scipy.spatial' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
