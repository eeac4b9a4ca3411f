from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.lidar.classified_scan import GroundPlane, PointClass, outside_view


def test_classes_are_the_numbers_that_files_hold() -> None:
    assert [c.name for c in PointClass] == ["INVALID", "CROPPED", "OUTLIER", "GROUND", "OBSTACLE"]
    assert [int(c) for c in PointClass] == [0, 1, 2, 3, 4]


@given(st.floats(1, 359.9), st.floats(-179.9, 180), st.floats(0.1, 50))
def test_field_of_view_agrees_with_the_azimuth(field_of_view_deg: float, azimuth_deg: float, range_m: float) -> None:
    if abs(abs(azimuth_deg) - field_of_view_deg / 2) < 1e-6:
        return
    azimuth = np.deg2rad(azimuth_deg)
    x_m, y_m = np.array([[range_m * np.cos(azimuth)], [range_m * np.sin(azimuth)]])
    assert outside_view(x_m, y_m, field_of_view_deg)[0] == (abs(azimuth_deg) > field_of_view_deg / 2)
    assert not outside_view(x_m, y_m, 360.0).any()


def test_heights_are_vertical_and_walls_are_no_ground() -> None:
    slope = np.tan(np.deg2rad(20))
    unit = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    plane = GroundPlane(unit, 0.5 * unit[2])
    on_slope = np.array([3.0, 1.0, -0.5 + 3.0 * slope])
    heights_m = plane.height_m(on_slope + np.array([[0, 0, 0], [0, 0, 0.8], [0, 0, -0.2]]))
    assert heights_m == pytest.approx([0.0, 0.8, -0.2])
    assert plane.is_level
    assert not GroundPlane(np.array([-1.0, 0.0, 0.05]) / np.hypot(1, 0.05), 0.0).is_level
