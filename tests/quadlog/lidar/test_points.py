from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.lidar.classified_scan import PointClass, in_field_of_view, valid_points


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


@settings(deadline=None)
@given(arrays(np.float64, (20, 3), elements=st.floats(-40, 40)))
def test_range_agrees_with_the_norm(cloud: np.ndarray) -> None:
    range_m = np.linalg.norm(cloud, axis=1)
    clear = (np.abs(range_m - 1) > 1e-9) & (np.abs(range_m - 30) > 1e-9)
    assert (valid_points(cloud, 1.0, 30.0) == ((range_m >= 1) & (range_m <= 30)))[clear].all()


@settings(deadline=None)
@given(st.floats(1, 359.9), st.floats(-179.9, 180), st.floats(0.1, 50))
def test_field_of_view_agrees_with_the_azimuth(field_of_view_deg: float, azimuth_deg: float, range_m: float) -> None:
    if abs(abs(azimuth_deg) - field_of_view_deg / 2) < 1e-6:
        return
    azimuth = np.deg2rad(azimuth_deg)
    point = np.array([[range_m * np.cos(azimuth), range_m * np.sin(azimuth), 1.0]])
    assert in_field_of_view(point, field_of_view_deg)[0] == (abs(azimuth_deg) <= field_of_view_deg / 2)


def test_full_circle_keeps_what_is_straight_behind() -> None:
    assert in_field_of_view(np.array([[-1.0, 0.0, 0.0]]), 360.0).all()
