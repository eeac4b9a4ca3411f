from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import (
    FEWEST_RETURNS,
    ClassifiedReturns,
    ClassifiedScan,
    PointClass,
    cropped_to_base,
    in_field_of_view,
    valid_points,
)
from quadlog.lidar.deskew import Slots


def test_classes_are_the_numbers_that_files_hold() -> None:
    assert [(c.name, int(c)) for c in PointClass] == [
        ("INVALID", 0),
        ("CROPPED", 1),
        ("OUTLIER", 2),
        ("GROUND", 3),
        ("OBSTACLE", 4),
    ]


@pytest.mark.parametrize(
    "point", [(0, 0, 0), (np.nan, 1, 1), (1, np.inf, 1), (1, 1, -np.inf), (1e30, 0, 0), (3.4e38, 3.4e38, 3.4e38)]
)
@pytest.mark.parametrize("min_range_m", [0.0, 0.3])
def test_no_return_is_not_valid(point: tuple[float, ...], min_range_m: float) -> None:
    cloud = np.array([point, (1, 2, 3)], dtype=np.float32)
    assert valid_points(cloud, min_range_m, 30.0).tolist() == [False, True]


def test_range_limits_are_inclusive() -> None:
    cloud = np.array([[0.5, 0, 0], [0, 0.4999, 0], [0, 0, -8], [8.001, 0, 0]])
    assert valid_points(cloud, 0.5, 8.0).tolist() == [True, False, True, False]


@given(arrays(np.float64, (20, 3), elements=st.floats(-40, 40)))
def test_range_agrees_with_the_norm(cloud: np.ndarray) -> None:
    range_m = np.linalg.norm(cloud, axis=1)
    clear = (np.abs(range_m - 1) > 1e-9) & (np.abs(range_m - 30) > 1e-9)
    assert (valid_points(cloud, 1.0, 30.0) == ((range_m >= 1) & (range_m <= 30)))[clear].all()


@given(st.floats(1, 359.9), st.floats(-179.9, 180), st.floats(0.1, 50))
def test_field_of_view_agrees_with_the_azimuth(field_of_view_deg: float, azimuth_deg: float, range_m: float) -> None:
    if abs(abs(azimuth_deg) - field_of_view_deg / 2) < 1e-6:
        return
    azimuth = np.deg2rad(azimuth_deg)
    x_m, y_m = np.array([[range_m * np.cos(azimuth)], [range_m * np.sin(azimuth)]])
    assert in_field_of_view(x_m, y_m, field_of_view_deg)[0] == (abs(azimuth_deg) <= field_of_view_deg / 2)


def test_full_circle_keeps_what_is_straight_behind() -> None:
    assert in_field_of_view(np.array([-1.0]), np.array([0.0]), 360.0).all()


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
    scan, slots = ClassifiedScan(xyz_m, label, None, height_m, "rings"), Slots(np.zeros(1, np.int64), None)
    returns = ClassifiedReturns.of_points(scan, np.zeros(3), np.zeros(len(label), np.uint8), slots)
    assert returns.shows_nothing == nothing
