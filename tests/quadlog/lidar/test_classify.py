from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import FEWEST_RETURNS, ClassifiedScan, PointClass, cropped_to_base


def test_points_are_moved_to_base_and_cropped_there() -> None:
    # The lidar looks backwards, half a metre up: what it calls ahead is behind the robot.
    mount = transform_from_rpy(np.array([0.2, 0.0, 0.5]), 0.1, -0.05, np.pi)
    cloud = np.array([[5, 1, 0], [-5, 1, 0], [np.nan, 0, 0], [0, 0, 0], [100, 0, 0]], dtype=np.float32)

    xyz_base_m, label = cropped_to_base(cloud, mount, 0.3, 30.0, 180.0)

    invalid = PointClass.INVALID
    assert label.tolist() == [PointClass.CROPPED, PointClass.OBSTACLE, invalid, invalid, invalid]
    assert xyz_base_m[:2] == pytest.approx(apply_transform(mount, cloud[:2].astype(np.float64)))
    assert np.isnan(xyz_base_m[2:]).all()


@pytest.mark.parametrize(
    ("seen", "nothing"),
    [((0, 0), True), ((FEWEST_RETURNS - 1, 0), True), ((5, FEWEST_RETURNS - 5), False), ((0, FEWEST_RETURNS), False)],
)
def test_a_scan_shows_something_by_its_ground_and_obstacles(seen: tuple[int, int], nothing: bool) -> None:
    kinds = [PointClass.INVALID, PointClass.CROPPED, PointClass.OUTLIER, PointClass.GROUND, PointClass.OBSTACLE]
    label = np.repeat(np.array(kinds, np.uint8), [100, 100, 100, *seen])
    xyz_m, height_m = np.zeros((len(label), 3), np.float32), np.zeros(len(label), np.float32)
    assert ClassifiedScan(xyz_m, label, None, height_m, "rings").shows_nothing == nothing
