from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.points import valid_points
from quadlog.lidar.polar import to_polar


@settings(max_examples=100, deadline=None)
@given(
    arrays(np.float32, (30, 3), elements=st.floats(-40, 40, width=32) | st.sampled_from([0.0, np.nan, np.inf, 1e30])),
    st.floats(-3, 3),
)
def test_directions_and_places_agree_with_numpy(cloud: np.ndarray, yaw_rad: float) -> None:
    transform = transform_from_rpy(np.array([0.3, -0.2, 0.5]), 0.1, -0.2, yaw_rad)
    polar = to_polar(cloud, transform, 0.3, 30.0)
    valid = valid_points(cloud, 0.3, 30.0)
    # Distances are computed in float32: those at a limit may fall on either side.
    sure = valid_points(cloud, 0.300001, 29.9999) | ~valid_points(cloud, 0.299999, 30.0001)
    assert ((polar.range_m > 0) == valid)[sure].all()
    valid = polar.range_m > 0
    assert np.isnan(polar.xyz_base_m[~valid]).all()
    points = cloud[valid].astype(np.float64)
    assert np.allclose(polar.xyz_base_m[valid], apply_transform(transform, points), atol=1e-5)
    range_m = np.linalg.norm(points, axis=1)
    assert np.allclose(polar.range_m[valid], range_m, rtol=1e-6)
    assert np.allclose(polar.sine[valid], points[:, 2] / range_m, atol=1e-6)
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    apart = (polar.turn[valid] - turn + 0.5) % 1 - 0.5
    # What is right above the lidar has no azimuth.
    aside = np.hypot(points[:, 0], points[:, 1]) > 1e-20
    assert np.abs(apart[aside]).max(initial=0) < 3e-6
    assert ((polar.turn >= 0) & (polar.turn < 1)).all()
