from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.lidar.classified_scan import valid_points
from quadlog.lidar.range_image import to_polar


@settings(max_examples=100, deadline=None)
@given(arrays(np.float32, (30, 3), elements=st.floats(-40, 40, width=32) | st.sampled_from([0, np.nan, np.inf, 1e30])))
def test_directions_agree_with_numpy(cloud: np.ndarray) -> None:
    polar = to_polar(tuple(cloud.T.copy()), (0.3, 30.0))
    # Distances are computed in float32: those at a limit may fall on either side.
    sure = valid_points(cloud, 0.300001, 29.9999) | ~valid_points(cloud, 0.299999, 30.0001)
    assert ((polar.range_m > 0) == valid_points(cloud, 0.3, 30.0))[sure].all()
    valid = polar.range_m > 0
    points = cloud[valid].astype(np.float64)
    range_m = np.linalg.norm(points, axis=1)
    assert np.allclose(polar.range_m[valid], range_m, rtol=1e-6)
    assert np.allclose(polar.sine[valid], points[:, 2] / range_m, atol=1e-6)
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    assert np.abs((polar.turn[valid] - turn + 0.5) % 1 - 0.5).max(initial=0) < 1e-6
    assert ((polar.turn >= 0) & (polar.turn < 1)).all()
