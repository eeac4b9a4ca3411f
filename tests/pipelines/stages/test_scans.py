"""What is kept of a cloud."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config.file import load_config
from quadlog.lidar.deskew import Skewed
from quadlog.lidar.levelling import NotLevelled
from quadlog.messages import Float, ImuSeries, Int, PointCloud, PoseSeries
from quadlog.pipelines.stages.maps import deskewed
from quadlog.pipelines.stages.mount import LidarMount, up_of_base
from quadlog.pipelines.stages.scans import ReducedScan, Scanner
from quadlog.recordings.tf_tree import TransformTree

T_NS = 1_700_000_000_000_000_000
MOUNT_M = 0.4


class Seen:
    """What becomes of a cloud beside orientations."""

    def __init__(
        self, *settings: str, imu: Float | None, odometry: Float | None = None, tree: TransformTree | None = None
    ) -> None:
        """imu, odometry: (N, 4) orientations, 20 ms apart about T_NS."""
        config, mount, tree = load_config(None, list(settings), {}), np.eye(4), tree or TransformTree()
        mount[2, 3] = MOUNT_M
        of_imu = None if imu is None else ImuSeries(at(len(imu)), np.zeros((len(imu), 3)), imu, "imu")
        poses = None if odometry is None else PoseSeries(at(len(odometry)), np.zeros((len(odometry), 3)), odometry)
        streams: Any = SimpleNamespace(odometry=poses, tf=tree, clouds_ns=at(1))
        up = up_of_base(streams, tree, config.topics, of_imu) if config.lidar.level else None
        data: Any = SimpleNamespace(streams=streams, mount=LidarMount(mount), up=up)
        self._scanner = Scanner(config, 0, data, maps=True)

    def take(self, cloud: PointCloud, t_ns: int = T_NS) -> ReducedScan:
        return self._scanner.classified(t_ns, cloud)


def at(count: int) -> Int:
    return T_NS + np.arange(-10, count - 10, dtype=np.int64) * 20_000_000


def tilted(roll_deg: float, count: int = 21) -> Float:
    quat_xyzw = np.tile(Rotation.from_euler("x", roll_deg, degrees=True).as_quat(), (count, 1))
    quat_xyzw[::2] *= -1  # the same orientation: only a driver that never changes a digit is frozen
    return quat_xyzw


FROZEN = np.tile([0.0, 0.0, 0.0, 1.0], (21, 1))


def cloud(roll_deg: float = 0.0, offset_ns: np.ndarray | None = None) -> PointCloud:
    """16 beams over flat ground within a wall 6 m away, as a lidar rolled by roll_deg sees them."""
    azimuth_rad = np.repeat(np.arange(900) * (2 * np.pi / 900), 16)
    ring = np.tile(np.arange(16, dtype=np.uint16), 900)
    elevation_rad = np.radians(2.0 * ring - 15)
    flat = np.cos(elevation_rad)
    body = np.column_stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)])
    level = Rotation.from_euler("x", roll_deg, degrees=True).apply(body)
    with np.errstate(divide="ignore"):
        to_ground = np.where(level[:, 2] < 0, -MOUNT_M * np.cos(np.radians(roll_deg)) / level[:, 2], np.inf)
    range_m = np.minimum(to_ground, 6 / np.hypot(level[:, 0], level[:, 1]))
    return PointCloud(T_NS, "lidar", (body * range_m[:, None]).astype(np.float32), ring, offset_ns)


def tilt_deg(scan: ReducedScan) -> float:
    return float(np.degrees(np.arccos(scan.row["ground_nz"])))


@pytest.mark.parametrize(
    ("settings", "imu", "odometry", "expected_deg"),
    [
        ([], tilted(8.0), None, 0.0),
        (["lidar.level=false"], tilted(8.0), None, 8.0),
        ([], None, tilted(8.0), 0.0),
        ([], FROZEN, None, 8.0),
        ([], FROZEN, tilted(8.0), 0.0),
        ([], tilted(8.0, 5), None, 0.0),
    ],
    ids=["imu", "not wanted", "odometry", "frozen", "frozen beside odometry", "too old"],
)
def test_the_bodys_tilt_is_taken_out_where_it_is_known(settings, imu, odometry, expected_deg):
    scan = Seen(*settings, imu=imu, odometry=odometry).take(cloud(roll_deg=8.0))
    assert tilt_deg(scan) == pytest.approx(expected_deg, abs=0.3)
    assert scan.not_levelled is None


def test_where_nothing_else_tells_the_tilt_moving_tf_does():
    tree = TransformTree()
    values = np.concatenate([np.zeros((21, 3)), tilted(8.0)], axis=1)
    tree.add_moving("/tf", "map", "base_link", np.arange(21), at(21), values)
    assert tilt_deg(Seen(imu=None, tree=tree).take(cloud(roll_deg=8.0))) == pytest.approx(0.0, abs=0.3)


def test_an_orientation_that_is_too_old_is_not_used():
    scan = Seen(imu=tilted(8.0)).take(cloud(roll_deg=8.0), T_NS + 1_000_000_000)
    assert tilt_deg(scan) == pytest.approx(8.0, abs=0.3)
    assert scan.not_levelled is NotLevelled.STALE


@pytest.mark.parametrize(
    ("offset_ns", "deskew", "slots", "skewed"),
    [
        (np.repeat(np.arange(900, dtype=np.int64) * 100_000, 16), "true", 32, None),
        (np.repeat(np.arange(900, dtype=np.int64) * 100_000, 16), "false", 1, Skewed.NO_TIMES),
        (None, "true", 1, Skewed.NO_TIMES),
        (np.full(14400, 7_000_000_000_000), "true", 1, Skewed.NO_TIMES),
        (np.repeat(np.arange(900, dtype=np.int64) * 1_000_000_000, 16), "true", 1, Skewed.ABSURD_TIMES),
    ],
)
def test_when_points_were_measured_is_kept_as_far_as_it_can_be(offset_ns, deskew, slots, skewed):
    row = Seen(f"lidar.deskew={deskew}", imu=tilted(0.0)).take(cloud(offset_ns=offset_ns))
    assert (len(row.slot_ns), row.skewed) == (slots, skewed)
    assert (np.diff(row.slot_ns) > 0).all()
    assert len(row.slot_ns) == slots


def test_an_empty_cloud_shows_nothing():
    seen = Seen(imu=tilted(0.0))
    scan, empty = seen.take(cloud()), seen.take(PointCloud(T_NS, "lidar", np.empty((0, 3), np.float32)))
    assert (scan.level, scan.row["n_raw"], scan.row["n_valid"]) == (True, 14400, 14400)
    assert scan.row["n_ground"] + scan.row["n_obstacle"] + scan.row["n_outlier"] == 14400
    assert (empty.level, empty.row["n_raw"], empty.row["ground_found"], empty.shows_nothing) == (None, 0, False, True)


@pytest.mark.parametrize(("method", "route"), [("range_image", "rings"), ("paper", "paper")])
def test_every_scan_says_how_it_was_classified(method, route):
    assert Seen(f"lidar.method={method}", imu=tilted(0.0)).take(cloud()).route == route


def test_points_are_put_where_they_were_at_the_scans_instant():
    """A robot that walks at 2 m/s and turns at 1 rad/s sees the origin of map, from where it is in every slot."""
    slot_s = np.linspace(0, 0.1, 32)
    slot_pose = np.column_stack([1 + 2 * slot_s, np.full(32, 3.0), slot_s])
    x_m, y_m, yaw_rad = slot_pose.T
    seen_m = np.column_stack(
        [-np.cos(yaw_rad) * x_m - np.sin(yaw_rad) * y_m, np.sin(yaw_rad) * x_m - np.cos(yaw_rad) * y_m, slot_s]
    )
    moved_m = deskewed(seen_m, np.arange(32, dtype=np.uint8), np.array([1.0, 3.0, 0.5]), slot_pose)
    expected_m = Rotation.from_euler("z", -0.5).apply([-1.0, -3.0, 0.0])
    np.testing.assert_allclose(moved_m[:, :2], np.tile(expected_m[:2], (32, 1)), atol=1e-6)
    np.testing.assert_allclose(moved_m[:, 2], slot_s, atol=1e-6)
