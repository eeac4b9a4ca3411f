"""What the pass over a recording keeps of a cloud."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config.file import load_config
from quadlog.lidar.deskew import Skewed
from quadlog.lidar.levelling import NotLevelled
from quadlog.mapping.compact import CompactScan
from quadlog.messages import Float, Imu, Int, PointCloud, Pose
from quadlog.pipelines.stages.perceive import deskewed
from quadlog.pipelines.stages.scans import Scanner, ScanRow, ScanSettings, Spill, end_of_sweep_ns
from quadlog.pipelines.stages.tilt import Tilt
from quadlog.recordings.decoders.columns import Columns
from quadlog.recordings.gathering import Many
from quadlog.recordings.tf_tree import TransformTree

T_NS = 1_700_000_000_000_000_000
MOUNT_M = 0.4


IMU, ODOMETRY = "/imu", "/odom"


class Seen:
    """What the pass over a recording does with a cloud after it has read orientations, and what is told of it later."""

    def __init__(
        self,
        folder: Path,
        *settings: str,
        imu: Float | None,
        odometry: Float | None = None,
        tree: TransformTree | None = None,
    ) -> None:
        """imu, odometry: (N, 4) orientations, 20 ms apart about T_NS."""
        self.config = load_config(None, list(settings), {})
        self.mount = np.eye(4)
        self.mount[2, 3] = MOUNT_M
        of_imu = [Imu(0, "imu", each, np.zeros(3), np.zeros(3)) for each in ([] if imu is None else imu)]
        recording = SimpleNamespace(sample=lambda topic, count: of_imu[:count])
        topics = IMU if imu is not None else None, ODOMETRY if odometry is not None else None
        self.tilt = Tilt(recording, *[tree or TransformTree()] * 2, self.config, *topics)  # type: ignore[arg-type]
        for topic, kind, quat_xyzw in ((IMU, Imu, imu), (ODOMETRY, Pose, odometry)):
            if quat_xyzw is not None:
                values = np.concatenate([np.zeros((len(quat_xyzw), 3)), quat_xyzw], axis=1)
                self.tilt.take(Many(np.arange(len(values)), at(len(values)), topic, Columns(kind, None, values)))
        self.spill = Spill(folder)
        scans = ScanSettings.of_config(self.config, maps=True)
        self.scanner = Scanner(scans, 0, self.mount, self.tilt, self.spill)

    def take(self, cloud: PointCloud, t_ns: int = T_NS) -> ScanRow:
        self.scanner.take(t_ns, cloud)
        return [ScanRow.from_bytes(each) for each in self.spill][-1]


@pytest.fixture
def look(tmp_path) -> Iterator[Callable[..., Seen]]:
    with ExitStack() as stack:

        def made(*settings: str, **orientations: Any) -> Seen:
            seen = Seen(tmp_path, *settings, **orientations)
            stack.enter_context(seen.spill)
            return seen

        yield made


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


def tilt_deg(row: ScanRow) -> float:
    return float(np.degrees(np.arccos(row.normal[2])))


@pytest.mark.parametrize(
    ("settings", "imu", "odometry", "expected_deg"),
    [
        ([], tilted(8.0), None, 0.0),
        (["lidar.level=false"], tilted(8.0), None, 8.0),
        ([], None, tilted(8.0), 0.0),
        ([], FROZEN, None, 8.0),
        ([], FROZEN, tilted(8.0), 0.0),
        ([], np.concatenate([FROZEN, FROZEN, FROZEN[:20], tilted(8.0, 1)]), None, 8.0),
        ([], tilted(8.0, 5), None, 0.0),
    ],
    ids=["imu", "not wanted", "odometry", "frozen", "frozen beside odometry", "frozen until it is too late", "too old"],
)
def test_the_bodys_tilt_is_taken_out_where_it_is_known(settings, imu, odometry, expected_deg, look):
    seen = look(*settings, imu=imu, odometry=odometry)
    assert tilt_deg(seen.take(cloud(roll_deg=8.0))) == pytest.approx(expected_deg, abs=0.3)
    assert seen.scanner.tally.tilted == {}


def test_where_nothing_else_tells_the_tilt_moving_tf_does(look):
    tree = TransformTree()
    values = np.concatenate([np.zeros((21, 3)), tilted(8.0)], axis=1)
    tree.add_moving("/tf", "map", "base_link", np.arange(21), at(21), values)
    seen = look(imu=None, tree=tree)
    assert tilt_deg(seen.take(cloud(roll_deg=8.0))) == pytest.approx(0.0, abs=0.3)


def test_an_orientation_that_is_too_old_is_not_used_and_counted(look):
    seen = look(imu=tilted(8.0))
    assert tilt_deg(seen.take(cloud(roll_deg=8.0), T_NS + 1_000_000_000)) == pytest.approx(8.0, abs=0.3)
    assert seen.scanner.tally.tilted == {NotLevelled.STALE: 1}


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
def test_when_points_were_measured_is_kept_as_far_as_it_can_be(offset_ns, deskew, slots, skewed, look):
    row = look(f"lidar.deskew={deskew}", imu=tilted(0.0)).take(cloud(offset_ns=offset_ns))
    assert (len(row.slot_ns), row.skewed) == (slots, skewed)
    assert (np.diff(row.slot_ns) > 0).all()
    assert len(CompactScan.from_bytes(row.compact).slot_ns) == slots


@pytest.mark.parametrize(("step_ns", "last_ns"), [(100_000, 89_900_000), (1_000_000_000, 0)])
def test_a_sweep_ends_with_its_last_point_unless_its_times_are_absurd(step_ns, last_ns):
    offset_ns = np.repeat(np.arange(900, dtype=np.int64) * step_ns, 16)
    assert end_of_sweep_ns(T_NS, cloud(offset_ns=offset_ns)) == T_NS + last_ns


def test_a_row_is_read_back_as_it_was_written(look):
    seen = look(imu=tilted(0.0))
    row = seen.take(cloud())
    assert row.ground_found
    assert row.n_raw == row.n_valid == 14400
    assert row.n_ground + row.n_obstacle + row.n_outlier == 14400
    empty = seen.take(PointCloud(T_NS, "lidar", np.empty((0, 3), np.float32)))
    assert (empty.n_raw, empty.ground_found, empty.shows_nothing, empty.ground) == (0, False, True, None)


def test_every_scan_says_how_it_was_seen(look):
    for method, route in (("range_image", "rings"), ("paper", "paper")):
        seen = look(f"lidar.method={method}", imu=tilted(0.0))
        for _ in range(3):
            seen.take(cloud())
        assert seen.scanner.tally.routes == {route: 3}


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
