"""Planar scanners: LaserScan and MultiEchoLaserScan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadlog.errors import DecodeError
from quadlog.lidar.point_times import find_reading
from quadlog.messages import PointCloud
from tests.lab.decoded import decoded

T_NS = 1_700_000_000_000_000_005
SCAN = {"angle_increment": np.pi / 2, "time_increment": 0.01, "range_min": 0.1, "range_max": 30.0}


def scanned(ros: Any, *ranges_m: float, name: str = "LaserScan", **changed: Any) -> PointCloud:
    """The cloud of a scan with a ray every 90 degrees."""
    values = {"header": ros.header(T_NS, "laser"), "ranges": list(ranges_m)} | SCAN | changed
    message = ros.make(f"sensor_msgs/msg/{name}", **values)
    (cloud,) = decoded(ros.channel("/scan", message.__msgtype__), ros.serialise(message))
    assert isinstance(cloud, PointCloud)
    return cloud


def test_each_ray_is_a_point_of_one_ring_measured_in_its_turn(ros: Any) -> None:
    cloud = scanned(ros, 1.0, 2.0, 3.0)
    np.testing.assert_allclose(cloud.xyz_m, [[1, 0, 0], [0, 2, 0], [-3, 0, 0]], atol=1e-6)
    np.testing.assert_array_equal(cloud.ring, [0, 0, 0])
    assert (cloud.stamp_ns, cloud.frame_id) == (T_NS, "laser")
    turned = scanned(ros, 1.0, 2.0, 3.0, angle_min=np.pi / 2)
    np.testing.assert_allclose(turned.xyz_m, [[0, 1, 0], [-2, 0, 0], [0, -3, 0]], atol=1e-6)


@pytest.mark.parametrize(
    ("step", "apart_s"),
    [(0.01, 0.1), (10.0, 0.1), (1e4, 0.1), (1e7, 0.1), (-0.01, 0.1), (1e4, 5.0), (0, 1), (np.nan, 1)],
)
def test_rays_are_measured_in_turn_in_the_unit_in_which_they_take_a_scan(ros: Any, step: float, apart_s: float) -> None:
    """Even of scans that come rarely; those without times at once."""
    clouds = [scanned(ros, 1.0, 2.0, 3.0, time_increment=step)]
    if not abs(step) > 0:
        assert clouds[0].time_fields == {}
        return
    reading = find_reading(clouds, T_NS + np.arange(5) * round(apart_s * 1e9))
    assert reading.timed(clouds[0]).offset_ns.tolist() == [0, *np.multiply([1e7, 2e7], np.sign(step)).tolist()]


def test_what_lies_outside_the_limits_is_no_return(ros: Any) -> None:
    cloud = scanned(ros, 1.0, np.inf, -np.inf, np.nan, 0.0, 0.05, 31.0, -1.0)
    assert np.isfinite(cloud.xyz_m).any(axis=1).tolist() == [True] + 7 * [False]


@pytest.mark.parametrize("step_rad", [0.0, np.nan])
def test_rays_without_angles_are_refused(ros: Any, step_rad: float) -> None:
    with pytest.raises(DecodeError, match="no angles"):
        scanned(ros, 1.0, 2.0, angle_increment=step_rad)


def test_the_nearest_valid_echo_of_several_counts(ros: Any) -> None:
    rays = [ros.make("sensor_msgs/msg/LaserEcho", echoes=each) for each in ([5.0, 4.0], [], [np.inf, 2.0])]
    cloud = scanned(ros, name="MultiEchoLaserScan", ranges=rays)
    np.testing.assert_allclose(cloud.xyz_m[[0, 2]], [[4, 0, 0], [-2, 0, 0]], atol=1e-6)
    assert np.isnan(cloud.xyz_m[1]).all()
