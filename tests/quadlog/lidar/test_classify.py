from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classify import cropped_to_base
from quadlog.lidar.points import PointClass


def test_points_are_moved_to_base_and_cropped_there() -> None:
    # The lidar looks backwards, half a metre up: what it calls ahead is behind the robot.
    mount = transform_from_rpy(np.array([0.2, 0.0, 0.5]), 0.1, -0.05, np.pi)
    cloud = np.array([[5, 1, 0], [-5, 1, 0], [np.nan, 0, 0], [0, 0, 0], [100, 0, 0]], dtype=np.float32)

    xyz_base_m, label = cropped_to_base(cloud, mount, 0.3, 30.0, 180.0)

    invalid = PointClass.INVALID
    assert label.tolist() == [PointClass.CROPPED, PointClass.OBSTACLE, invalid, invalid, invalid]
    assert xyz_base_m[:2] == pytest.approx(apply_transform(mount, cloud[:2].astype(np.float64)))
    assert np.isnan(xyz_base_m[2:]).all()
