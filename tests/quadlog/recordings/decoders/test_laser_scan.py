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


def decode(ros: Any, message: Any) -> PointCloud:
    (cloud,) = decoded(ros.channel("/scan", message.__msgtype__), ros.serialise(message))
    assert isinstance(cloud, PointCloud)
    return cloud


def scan(
    ros: Any, ranges_m: list[float], *, step_rad: float = np.pi / 2, step_s: float = 0.01, first_rad: float = 0.0
) -> Any:
    kind = ros.type("sensor_msgs/msg/LaserScan")
    header, limits, none = ros.header(T_NS, "laser"), (0.1, 30.0), np.zeros(0, np.float32)
    return kind(header, first_rad, 3.0, step_rad, step_s, 0.1, *limits, np.array(ranges_m, np.float32), none)


def test_each_ray_is_a_point_of_one_ring_measured_in_its_turn(ros: Any) -> None:
    cloud = decode(ros, scan(ros, [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(cloud.xyz_m, [[1, 0, 0], [0, 2, 0], [-3, 0, 0]], atol=1e-6)
    assert cloud.ring is not None
    assert cloud.ring.tolist() == [0, 0, 0]
    assert (cloud.stamp_ns, cloud.frame_id) == (T_NS, "laser")
    turned = decode(ros, scan(ros, [1.0, 2.0, 3.0], first_rad=np.pi / 2))
    np.testing.assert_allclose(turned.xyz_m, [[0, 1, 0], [-2, 0, 0], [0, -3, 0]], atol=1e-6)


@pytest.mark.parametrize(
    ("step", "apart_s"), [(0.01, 0.1), (10.0, 0.1), (1e4, 0.1), (1e7, 0.1), (-0.01, 0.1), (1e4, 5.0)]
)
def test_rays_are_measured_in_turn_in_the_unit_in_which_they_take_a_scan(ros: Any, step: float, apart_s: float) -> None:
    """Even of scans that come rarely."""
    clouds = [decode(ros, scan(ros, [1.0, 2.0, 3.0], step_s=step))]
    reading = find_reading(clouds, T_NS + np.arange(5) * round(apart_s * 1e9))
    assert reading.timed(clouds[0]).offset_ns.tolist() == [0, *np.multiply([1e7, 2e7], np.sign(step)).tolist()]


@pytest.mark.parametrize("nothing_m", [np.inf, -np.inf, np.nan, 0.0, 0.05, 31.0, -1.0])
def test_what_lies_outside_the_limits_is_no_return(ros: Any, nothing_m: float) -> None:
    cloud = decode(ros, scan(ros, [1.0, nothing_m]))
    assert np.isfinite(cloud.xyz_m[0]).all()
    assert np.isnan(cloud.xyz_m[1]).all()


def test_rays_without_times_were_measured_at_once(ros: Any) -> None:
    for step_s in (0.0, np.nan):
        assert decode(ros, scan(ros, [1.0, 2.0], step_s=step_s)).time_fields == {}


@pytest.mark.parametrize("step_rad", [0.0, np.nan])
def test_rays_without_angles_are_refused(ros: Any, step_rad: float) -> None:
    with pytest.raises(DecodeError, match="no angles"):
        decode(ros, scan(ros, [1.0, 2.0], step_rad=step_rad))


def test_the_nearest_valid_echo_of_several_counts(ros: Any) -> None:
    echo, kind = ros.type("sensor_msgs/msg/LaserEcho"), ros.type("sensor_msgs/msg/MultiEchoLaserScan")
    rays = [echo(np.array(each, np.float32)) for each in ([5.0, 4.0], [], [np.inf, 2.0])]
    cloud = decode(ros, kind(ros.header(T_NS), 0.0, 3.0, np.pi / 2, 0.0, 0.1, 0.1, 30.0, rays, []))
    np.testing.assert_allclose(cloud.xyz_m[[0, 2]], [[4, 0, 0], [-2, 0, 0]], atol=1e-6)
    assert np.isnan(cloud.xyz_m[1]).all()
