"""What happens to a cloud before it is classified, on a walk cut down to what that needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config import Config
from quadlog.config_file import load_config
from quadlog.lidar.points import PointClass
from quadlog.messages import ImuSeries, PointCloud, Pose
from quadlog.pipelines.stages.scans import Scanner, Surroundings
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.recordings.tf_tree import TransformTree

T_NS = 1_700_000_000_000_000_000
MOUNT_M = 0.4


@dataclass
class Told:
    """The part of a Walk that scanning uses."""

    config: Config
    streams: SimpleNamespace
    robot: RobotTrack | None
    transform_lidar_to_base: np.ndarray
    seed: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        self.notes.append(text)

    def warn(self, text: str) -> None:
        self.warnings.append(text)


def walk(*settings: str, roll_deg=0.0, speed_mps=0.0, orientations=21) -> Told:
    config = load_config(None, list(settings), {})
    t_ns = T_NS + np.arange(-10, 11) * 20_000_000
    tilt = Rotation.from_euler("x", roll_deg, degrees=True).as_quat()
    quat_xyzw = np.tile(tilt, (21, 1))
    quat_xyzw[::2] *= -1  # the same orientation: only a driver that never changes a digit is frozen
    keep = slice(0, orientations)
    imu = ImuSeries(t_ns[keep], np.zeros((21, 3))[keep], quat_xyzw[keep])
    xy_m = np.column_stack([speed_mps * (t_ns - T_NS) * 1e-9, np.zeros(21)])
    mount = np.eye(4)
    mount[2, 3] = MOUNT_M
    streams = SimpleNamespace(imu=imu, odometry=None, tf=TransformTree())
    return Told(config, streams, RobotTrack(t_ns, xy_m, np.zeros(21), "uwb"), mount)


def scanner_of(told: Told) -> Scanner:
    return Scanner(Surroundings.of_walk(told))  # type: ignore[arg-type]


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


def ground_tilt_deg(scan) -> float:
    return float(np.degrees(np.arccos(scan.ground.normal[2])))


@pytest.mark.parametrize(("level", "expected_deg"), [("true", 0.0), ("false", 8.0)])
def test_the_bodys_tilt_is_taken_out_where_wanted(level: str, expected_deg: float) -> None:
    told = walk(f"lidar.level={level}", roll_deg=8.0)
    scan, pose = scanner_of(told).classify(T_NS, cloud(roll_deg=8.0))
    assert pose == pytest.approx(np.zeros(3))
    assert ground_tilt_deg(scan) == pytest.approx(expected_deg, abs=0.3)


def test_where_nothing_else_tells_the_tilt_moving_tf_does() -> None:
    told = walk(roll_deg=8.0)
    imu, told.streams.imu = told.streams.imu, None
    for t_ns, quat_xyzw in zip(imu.t_ns.tolist(), imu.quat_xyzw, strict=True):
        told.streams.tf.add(t_ns, Pose(t_ns, "map", "base_link", np.zeros(3), quat_xyzw), static=False)
    scan, _ = scanner_of(told).classify(T_NS, cloud(roll_deg=8.0))
    assert ground_tilt_deg(scan) == pytest.approx(0.0, abs=0.3)


def test_an_orientation_that_is_too_old_is_not_used_and_said() -> None:
    told = walk(roll_deg=8.0)
    scanner = scanner_of(told)
    scan, pose = scanner.classify(T_NS + 1_000_000_000, cloud(roll_deg=8.0))
    assert pose is None
    assert ground_tilt_deg(scan) == pytest.approx(8.0, abs=0.3)
    scanner.tally.tell(told)
    assert told.warnings == ["1 of 1 scans keep the robot's tilt: no orientation within 0.2 s"]


def test_a_driver_that_always_sends_the_same_orientation_has_none() -> None:
    told = walk(roll_deg=8.0)
    told.streams.imu = ImuSeries(told.streams.imu.t_ns, np.zeros((21, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (21, 1)))
    scanner = scanner_of(told)
    scanner.classify(T_NS, cloud())
    scanner.tally.tell(told)
    assert told.warnings == []


def test_a_moving_robots_points_are_put_where_they_were_at_the_scans_instant() -> None:
    offset_ns = np.repeat(np.arange(900, dtype=np.int64) * 100_000, 16)
    still, _ = scanner_of(walk()).classify(T_NS, cloud(offset_ns=offset_ns))
    moving, _ = scanner_of(walk(speed_mps=2.0)).classify(T_NS, cloud(offset_ns=offset_ns))
    kept, _ = scanner_of(walk("lidar.deskew=false", speed_mps=2.0)).classify(T_NS, cloud(offset_ns=offset_ns))
    np.testing.assert_array_equal(kept.xyz_base_m, still.xyz_base_m)
    shift_m = moving.xyz_base_m - still.xyz_base_m
    np.testing.assert_allclose(shift_m[:, 0], 2.0 * offset_ns * 1e-9, atol=5e-3)
    np.testing.assert_allclose(shift_m[:, 1:], 0.0, atol=5e-3)


def test_times_that_cannot_be_are_counted_and_said() -> None:
    told = walk(speed_mps=2.0)
    scanner = scanner_of(told)
    scanner.classify(T_NS, cloud(offset_ns=np.full(14400, 7_000_000_000_000)))
    scanner.classify(T_NS, cloud(offset_ns=np.repeat(np.arange(900, dtype=np.int64) * 1_000_000_000, 16)))
    scanner.tally.tell(told)
    assert told.counts["scans_not_deskewed"] == 2
    assert any("the times of its points cannot be" in text for text in told.warnings)


def test_every_scan_says_how_it_was_seen() -> None:
    told = walk()
    scanner = scanner_of(told)
    for _ in range(3):
        scanner.classify(T_NS, cloud())
    scanner.tally.tell(told)
    assert told.notes == ["3 of 3 scans classified by the beams their points name"]
    paper = walk("lidar.method=paper")
    labels = scanner_of(paper).classify(T_NS, cloud())[0].label
    assert (labels == PointClass.CROPPED).mean() > 0.4, "the paper keeps the front half"
