"""What is kept of a cloud."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config.file import load_config
from quadlog.geometry import transform_from_rpy
from quadlog.lidar import scan_classifier
from quadlog.lidar.levelling import NotLevelled
from quadlog.lidar.point_times import AS_THEY_COME
from quadlog.messages import Float, ImuSeries, Int, PointCloud, PoseSeries, Timed
from quadlog.pipelines.stages.mount import LidarMount, up_of_base
from quadlog.pipelines.stages.scanners import PlacedScanner, Scanners, Sweep, turns_of
from quadlog.pipelines.stages.scans import Scanner, TimedScan
from quadlog.recordings.tf_tree import TransformTree

T_NS = 1_700_000_000_000_000_000
MOUNT_M = 0.4


def scanner(
    *settings: str,
    imu: Float | None,
    odometry: Float | None = None,
    moving: Float | None = None,
    behind: Float | None = None,
) -> Scanner:
    """What classifies clouds, beside (N, 4) orientations 20 ms apart about T_NS; moving: those of base in map by tf.

    behind: (4, 4) mount of a second lidar.
    """
    config, mount, tree = load_config(None, list(settings)), np.eye(4), TransformTree()
    mount[2, 3] = MOUNT_M
    if moving is not None:
        values = np.concatenate([np.zeros((len(moving), 3)), moving], axis=1)
        tree.add("/tf", "map", "base_link", at(len(moving)), values)
    of_imu = None if imu is None else ImuSeries(at(len(imu)), np.zeros((len(imu), 3)), imu, "imu")
    poses = None if odometry is None else PoseSeries(at(len(odometry)), np.zeros((len(odometry), 3)), odometry)
    streams: Any = SimpleNamespace(odometry=poses, tf=tree, clouds_ns=at(1))
    up = (
        up_of_base(streams, tree, None if moving is None else ("base_link", "map"), of_imu)
        if config.lidar.level
        else None
    )
    data: Any = SimpleNamespace(streams=streams, mount=LidarMount(mount), up=up, scanners=None)
    if behind is not None:
        several = [PlacedScanner("", LidarMount(each), None, AS_THEY_COME) for each in (mount, behind)]
        data.scanners = SimpleNamespace(each=several)
    return Scanner(config, 0, data)


def at(count: int) -> Int:
    return T_NS + np.arange(-10, count - 10, dtype=np.int64) * 20_000_000


def tilted(roll_deg: float, count: int = 21) -> Float:
    return np.tile(Rotation.from_euler("x", roll_deg, degrees=True).as_quat(), (count, 1))


def cloud(roll_deg: float = 0.0) -> PointCloud:
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
    return PointCloud(T_NS, "lidar", (body * range_m[:, None]).astype(np.float32), ring)


@pytest.mark.parametrize(
    ("settings", "known", "late_ns", "expected_deg"),
    [
        ([], {"imu": tilted(8.0)}, 0, 0.0),
        (["lidar.level=false"], {"imu": tilted(8.0)}, 0, 8.0),
        ([], {"imu": None, "odometry": tilted(8.0)}, 0, 0.0),
        ([], {"imu": None, "moving": tilted(8.0)}, 0, 0.0),
        ([], {"imu": tilted(8.0, 5)}, 0, 0.0),
        ([], {"imu": tilted(8.0)}, 1_000_000_000, 8.0),
    ],
    ids=["imu", "not wanted", "odometry", "tf", "some", "too old"],
)
def test_the_bodys_tilt_is_taken_out_where_it_is_known(settings, known, late_ns, expected_deg):
    scan = scanner(*settings, **known).classified(T_NS + late_ns, [Sweep(0, T_NS + late_ns, cloud(roll_deg=8.0))])
    assert np.degrees(np.arccos(scan.row["ground_nz"])) == pytest.approx(expected_deg, abs=0.3)
    assert scan.not_levelled is (NotLevelled.STALE if late_ns else None)


def test_each_of_several_scanners_is_classified_by_itself_and_lies_where_it_is():
    """One of 16 beams, and a planar one behind it, lower and 40 ms later."""
    azimuth_rad = np.arange(360) * (2 * np.pi / 360)
    planar = np.column_stack([5 * np.cos(azimuth_rad), 5 * np.sin(azimuth_rad), np.zeros(360)]).astype(np.float32)
    sweeps = [Sweep(0, T_NS, cloud()), Sweep(1, T_NS + 40_000_000, PointCloud(T_NS, "rear", planar))]
    both = scanner(imu=None, behind=transform_from_rpy(np.array([-0.5, 0.1, 0.2]), 0.0, 0.0, np.pi))
    one, two = scanner(imu=None).classified(T_NS, sweeps[:1]), both.classified(T_NS, sweeps)
    more = {name: value - one.row[name] for name, value in two.row.items() if value != one.row[name] and name != "ms"}
    assert (one.row["ground_found"], more) == (True, dict.fromkeys(("n_raw", "n_valid", "n_obstacle"), 360))
    np.testing.assert_allclose(two.found.xyz_base_m[-360:], [-0.5, 0.1, 0.2] + planar * [-1, -1, 1], atol=1e-5)
    assert two.slot_ns[two.found.returns.slot[[0, -1]]].tolist() == [T_NS, T_NS + 40_000_000]


def logged(*, behind: bool = False) -> list[tuple[int, list[Sweep]]]:
    """Turns of a sensor that sends rings from the second scan on, and fewer points in the eighth; then without beams.

    behind: a second scanner, in every second turn.
    """
    whole, scattered = cloud(), np.random.default_rng(0).normal(size=(2000, 3)).astype(np.float32)
    half, unnumbered = PointCloud(T_NS, "", whole.xyz_m[::2], whole.ring[::2]), PointCloud(T_NS, "", whole.xyz_m)
    clouds = [unnumbered, *[whole] * 6, half, *[whole] * 10, *[PointCloud(T_NS, "", scattered)] * 8, *[whole] * 3]
    second = [Sweep(1, T_NS, unnumbered)] if behind else []
    return [(T_NS, [Sweep(0, T_NS, each), *second[: number % 2]]) for number, each in enumerate(clouds)]


def known_values(scan: TimedScan) -> list[bytes]:
    return [each[scan.found.returns.label > 0].tobytes() for each in scan.found.returns]


@pytest.mark.parametrize(
    ("settings", "behind"),
    [([], False), (["lidar.method=paper"], False), ([], True)],
    ids=["beams", "paper", "two scanners"],
)
def test_any_number_of_threads_classifies_alike(monkeypatch, settings, behind):
    monkeypatch.setattr(scan_classifier, "SCANS_BETWEEN_LOOKS", 4)
    turns, found = logged(behind=behind)[: 12 if settings else None], []
    for threads in (1, 2, 3):
        scans = scanner(*settings, imu=None, behind=np.eye(4) if behind else None).all(turns, threads)
        found.append([(scan.found.route, *known_values(scan)) for scan in scans])
    assert found[1:] == found[:1] * 2
    assert len(found[0]) == len(turns)
    assert settings or len({route for route, *_ in found[0]}) >= 3


@pytest.mark.parametrize(
    ("front_ms", "rear_ms", "turns_ms"),
    [
        ((0, 100, 200), (40, 140, 240), (0, 100, 200)),
        ((0, 100, 200), (60, 160, 260), (0, 100, 200, 260)),  # each rear one is nearer to the next front one
        ((0, 100, 300), (30, 130, 230), (0, 100, 230, 300)),  # one in front is missing
        ((0, 100, 200), (-10, 90, 205), (0, 100, 200)),
        ((0, 100, 200), (), (0, 100, 200)),
    ],
)
def test_clouds_of_two_scanners_within_half_a_period_are_one(front_ms, rear_ms, turns_ms):
    scanner = np.array([0] * len(front_ms) + [1] * len(rear_ms))
    turn, t_ns = turns_of(scanner, np.array([*front_ms, *rear_ms], np.int64) * 1_000_000)
    assert (t_ns // 1_000_000).tolist() == list(turns_ms)
    assert sorted(set(turn.tolist())) == list(range(len(turns_ms)))
    assert np.bincount(turn).max() <= 2


def test_points_of_several_scanners_keep_their_places_in_base_and_their_times():
    """Scanners in front and behind, of which the one in front times its points."""
    ms, xyz_m = 1_000_000, np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], np.float32)
    places = ((0.2, 0.0), (-0.3, np.pi))
    mounts = [LidarMount(transform_from_rpy(np.array([x_m, 0.0, 0.0]), 0.0, 0.0, yaw_rad)) for x_m, yaw_rad in places]
    scanners = [PlacedScanner(f"/{n}", mount, None, AS_THEY_COME) for n, mount in enumerate(mounts)]
    first = PointCloud(T_NS, "front", xyz_m, offset_ns=np.array([0, 5 * ms]))
    logged = [Timed(T_NS, "/0", first), Timed(T_NS + 40 * ms, "/1", PointCloud(T_NS + 40 * ms, "rear", xyz_m))]
    turn, t_ns = turns_of(np.array([0, 1]), np.array([each.t_ns for each in logged]))
    several = Scanners(scanners, np.ones(2, bool), turn, t_ns)
    ((at_ns, sweeps),) = several.turns(logged)
    cloud = several.as_one(at_ns, sweeps)
    assert at_ns == T_NS
    assert cloud.xyz_m[:, 0] == pytest.approx([1.2, 2.2, -1.3, -2.3])
    assert cloud.offset_ns.tolist() == [0, 5 * ms, 40 * ms, 40 * ms]
