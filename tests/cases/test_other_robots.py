"""What a replay makes of logs of robots that nobody here has seen: one row for each way in which logs differ."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.cli.main import run as run_cli
from quadlog.geometry import turned
from quadlog.results.tables import read_table
from quadlog.storage.formats.ros_map import read_rosmap
from tests.lab.strangers import Log, Room, add_scans, header, instants_s, message, ns, rms_after_alignment_m, vector


class Case(NamedTuple):
    """A log, and what must come out: exit code, source of `poses`, greatest error, and what must be printed.

    walls: the least share of the occupied cells that lie on walls; True is 95 %.
    never: what must not be. settings: of the configuration.
    """

    make: Callable[[Log, Room], None]
    code: int = 0
    source: str | None = None
    rms_m: float = 0.01
    says: tuple[str, ...] = ()
    walls: float = False
    size_m: float = 6.0
    never: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    nowhere_s: tuple[float, float] | None = None
    """No pose lies between these seconds of the log."""


def tf(parent: str, child: str, duration_s: float = 8.0) -> Callable[[Log, Room], None]:
    def add(log: Log, room: Room) -> None:
        for t_s in instants_s(duration_s, 20):
            log.tf(ns(t_s), parent, child, room.at(t_s))

    return add


def fixes(*topics: str) -> Callable[[Log, Room], None]:
    """Satellite fixes at 45 degrees north, of metres east and north by the radii of the ellipsoid there."""

    def add(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 20):
            x_m, y_m, _ = room.at(t_s)
            north_deg, east_deg = 45.0 + np.degrees(y_m / 6_367_381.8), 9.0 + np.degrees(x_m / 4_517_590.9)
            status = message("sensor_msgs/msg/NavSatStatus", 0, 1)
            fix = (header(ns(t_s), "gps"), status, north_deg, east_deg, 100.0, np.zeros(9), 0)
            for topic in topics:
                log.add(topic, ns(t_s), message("sensor_msgs/msg/NavSatFix", *fix))

    return add


def velocities(topic: str, frame: str = "base_link", name: str = "TwistStamped") -> Callable[[Log, Room], None]:
    """As a wheeled robot measures them."""

    def add(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 50):
            (x, y, yaw), (later_x, later_y, later) = room.at(t_s), room.at(t_s + 1e-3)
            ahead, left = turned(np.array(-yaw), np.array([later_x - x, later_y - y]) * 1e3)
            if frame == "map":
                ahead, left = (later_x - x) * 1e3, (later_y - y) * 1e3
            twist = message("geometry_msgs/msg/Twist", vector(ahead, left, 0), vector(0, 0, (later - yaw) * 1e3))
            if name != "TwistStamped":
                twist = message("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
            log.add(topic, ns(t_s), message(f"geometry_msgs/msg/{name}", header(ns(t_s), frame), twist))

    return add


def odometry(log: Log, room: Room, topic: str = "/odom") -> None:
    for t_s in instants_s(8.0, 20):
        log.odometry(ns(t_s), room.at(t_s), topic)


def scans_only(beams: int) -> Callable[[Log, Room], None]:
    return lambda log, room: add_scans(log, room, 8.0, beams)


def base_scans(log: Log, room: Room) -> None:
    """A 2-D scanner at the origin of base."""
    add_scans(log, room, 8.0, 90, frame="base_link")


def lone_scanner(log: Log, room: Room) -> None:
    """The same on a robot whose odometry is known."""
    odometry(log, room)
    base_scans(log, room)


def together(*parts: Callable[[Log, Room], None]) -> Callable[[Log, Room], None]:
    def make(log: Log, room: Room) -> None:
        for part in parts:
            part(log, room)

    return make


def turned_scanner(frame: str, parent: str, topic: str) -> Callable[[Log, Room], None]:
    """A scanner that looks backwards, whose mount is repeated on `topic`."""

    def make(log: Log, room: Room) -> None:
        mount = (-0.1, 0.0, np.pi)
        add_scans(log, room, 8.0, mount=mount, frame=frame)
        for t_s in instants_s(8.0, 2):
            log.tf(ns(t_s), parent, frame, mount, 0.1, topic)

    return make


def covered(log: Log, room: Room) -> None:
    """A hand on the scanner for three of eight seconds."""
    add_scans(log, room, 8.0)
    for t_ns, _, scan in log.messages:
        if ns(3.0) <= t_ns < ns(6.0):
            scan.ranges[:] = 0.0


def interrupted(log: Log, room: Room) -> None:
    """Odometry that is silent for two of eight seconds."""
    odometry(log, room)
    log.messages = [row for row in log.messages if not ns(3.0) < row[0] < ns(5.0)]


def pose_topics(*topics: str) -> Callable[[Log, Room], None]:
    def make(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 10):
            for topic in topics:
                log.pose(ns(t_s), room.at(t_s), topic)

    return make


def localized(log: Log, room: Room) -> None:
    """The robot's odometry drifts, and a localization mends it by map -> odom."""
    for t_s in instants_s(8.0, 20):
        (x_m, y_m, yaw_rad), drift_m = room.at(t_s), 0.02 * t_s
        log.tf(ns(t_s), "map", "odom", (drift_m, 0.0, 0.0))
        log.tf(ns(t_s), "odom", "base_link", (x_m - drift_m, y_m, yaw_rad))


def mirrored_truth(log: Log, room: Room) -> None:
    odometry(log, room)
    for t_s in instants_s(8.0, 10):
        x_m, y_m, _ = room.at(t_s)
        log.pose(ns(t_s), (y_m, x_m, 0.0), "/mocap/pose")


def two_scanners(log: Log, room: Room) -> None:
    odometry(log, room)
    add_scans(log, room, 8.0, topic="/front/scan", frame="front_laser")
    add_scans(log, room, 8.0, mount=(0.0, 0.0, np.pi), topic="/rear/scan", frame="rear_laser")


def halves(log: Log, room: Room) -> None:
    """A scanner in front and one behind, which turns 40 ms later; each sees half of what is around."""
    odometry(log, room)
    for topic, late_s, mount in (("/front/scan", 0.0, (0.2, 0.0, 0.0)), ("/rear/scan", 0.04, (-0.3, 0.1, np.pi))):
        log.tf(ns(0.0), "base_link", topic, mount, 0.2, "/tf_static")
        for t_s in instants_s(7.9, 10):
            ranges_m = room.ranges_m(t_s + late_s, 180, mount, np.pi)
            log.scan(ns(t_s + late_s), ranges_m, np.pi, topic=topic, frame=topic)


BOTH = """topics.lidar=["/front/scan", "/rear/scan"]"""


def filtered_copy(log: Log, room: Room) -> None:
    tf("odom", "base_link")(log, room)
    add_scans(log, room, 8.0, frame="base_link")
    scans = [row for row in log.messages if row[1] == "/scan"]
    log.messages += [(t_ns + 30_000_000, "/stable_scan", scan) for t_ns, _, scan in scans[5:]]


def rings_of_points(log: Log, room: Room, frame: str, fixed: bool) -> None:
    """Clouds of walls alone, four rings that look upwards; fixed: with coordinates in the room, not about the robot."""
    for t_s in instants_s(8.0, 10):
        range_m = room.ranges_m(t_s, 200, (0.0, 0.0, 0.0), 2 * np.pi)
        angle_rad = -np.pi + 2 * np.pi / 200 * np.arange(200)
        x_m, y_m, yaw_rad = room.at(t_s) if fixed else (0.0, 0.0, 0.0)
        flat_m = np.stack([x_m + range_m * np.cos(yaw_rad + angle_rad), y_m + range_m * np.sin(yaw_rad + angle_rad)])
        rings = [np.vstack([flat_m, range_m * np.tan(up_rad)]).T for up_rad in (0.02, 0.06, 0.1, 0.14)]
        log.cloud(ns(t_s), np.concatenate(rings), frame=frame)


def turned_lidar(
    roll_deg: float = 0.0, pitch_deg: float = 0.0, *, as_level: bool = False
) -> Callable[[Log, Room], None]:
    """Odometry and eight rings of walls and floor by a lidar 0.45 m above it; as_level: tf has it mounted level."""

    def make(log: Log, room: Room) -> None:
        odometry(log, room)
        mount = Rotation.from_euler("xyz", [roll_deg, pitch_deg, 0.0], degrees=True)
        for t_s in instants_s(8.0, 10):
            range_m, angle_rad = room.ranges_m(t_s, 200, (0.0, 0.0, 0.0), 2 * np.pi), 2 * np.pi / 200 * np.arange(200)
            rings = []
            for up_rad in (-0.35, -0.3, -0.25, -0.2, -0.15, -0.1, 0.05, 0.1):
                away_m = np.minimum(range_m, 0.45 / np.tan(-up_rad) if up_rad < 0 else np.inf)
                flat_m = -away_m * [np.cos(angle_rad), np.sin(angle_rad)]
                rings.append(np.vstack([flat_m, away_m * np.tan(up_rad)]).T)
            log.cloud(ns(t_s), mount.inv().apply(np.concatenate(rings)))
        if as_level:
            log.tf(ns(0.0), "base_link", "velodyne", (0.0, 0.0, 0.0), 0.45, "/tf_static")

    return make


def unoriented(log: Log, room: Room) -> None:
    """Positions of a tracker that fills in no quaternion, beside scans."""
    pose_topics("/tracker/pose")(log, room)
    for _, _, content in log.messages:
        content.pose.orientation.z = content.pose.orientation.w = 0.0
    add_scans(log, room, 8.0)


def points_beside_odometry(log: Log, room: Room) -> None:
    """A tracker that counts as true and sends places alone."""
    odometry(log, room)
    for t_s in instants_s(8.0, 20):
        place = message("geometry_msgs/msg/Point", *map(float, room.at(t_s)[:2]), 0.0)
        log.add("/vicon/dog", ns(t_s), message("geometry_msgs/msg/PointStamped", header(ns(t_s), "odom"), place))


class Westward(Room):
    """A room without a turn."""

    def at(self, t_s: float) -> tuple[float, float, float]:
        return -0.5 * max(t_s - 1.0, 0.0), 0.0, np.pi


def reset(log: Log, room: Room) -> None:
    """Odometry that starts at zero again in the middle of the walk."""
    odometry(log, room)
    for t_ns, _, content in log.messages:
        content.pose.pose.position.x -= 1.5 * (t_ns >= ns(4.0))


def other_clock(log: Log, room: Room) -> None:
    """A scanner whose computer's clock is two minutes late."""
    lone_scanner(log, room)
    for _, topic, content in log.messages:
        content.header.stamp.sec -= 120 * (topic == "/scan")


def another_transform(log: Log, room: Room) -> None:
    """A sonar's, stamped by a clock of another day."""
    for t_s in instants_s(8.0, 10):
        log.tf(ns(t_s), "base_link", "sonar", (0.1, 0.0, 0.0))
        log.messages[-1][2].transforms[0].header.stamp.sec -= 90_000


def latched_pose(log: Log, room: Room) -> None:
    """As it stood before the log began."""
    log.pose(ns(0.0), (0.0, 0.0, 0.0), "/amcl_pose")
    log.messages[-1][2].header.stamp.sec -= 24


def vicon(log: Log, room: Room) -> None:
    """The body's place by motion capture, in frames of its own, beside scans."""
    for t_s in instants_s(8.0, 50):
        log.pose(ns(t_s), room.at(t_s), "/vicon/go1/go1", "world")
    add_scans(log, room, 8.0)


def set_back(make: Callable[[Log, Room], None]) -> Callable[[Log, Room], None]:
    """The same log with header stamps that jump back by 3 s in its middle."""

    def changed(log: Log, room: Room) -> None:
        make(log, room)
        for t_ns, _, content in log.messages:
            if t_ns >= ns(5.0):
                stamped = content.transforms[0] if hasattr(content, "transforms") else content
                stamped.header.stamp.sec -= 3

    return changed


LEGS = [f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")]
ARM = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
GRIPPER = ["rh_l1", "rh_r1", "rh_l2", "rh_r2"]
WHEELS = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]


def level_imu(gravity_mps2: float) -> Callable[[Log, Room], None]:
    def make(log: Log, room: Room) -> None:
        odometry(log, room)
        for t_s in instants_s(8.0, 50):
            log.imu(ns(t_s), gravity_mps2)

    return make


def standing(log: Log, room: Room) -> None:
    """Odometry and truth of a robot that never moves."""
    for t_s in instants_s(8.0, 20):
        log.odometry(ns(t_s), (1.0, 2.0, 0.5))
        log.pose(ns(t_s), (1.0, 2.0, 0.5), "/mocap/pose", "odom")


def joints(*names: str, zeros: bool = False) -> Callable[[Log, Room], None]:
    def make(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 50):
            log.joints(ns(t_s), list(names), efforts_nm=np.zeros(len(names)) if zeros else None)

    return make


CASES = {
    "scans-3m": Case(scans_only(90), 0, "lidar", 0.05, size_m=3.0),
    "scans-5m-60-beams": Case(scans_only(60), 0, "lidar", 0.06, size_m=5.0),
    "scans-10m": Case(scans_only(360), 0, "lidar", 0.05, size_m=10.0),
    "scans-20m": Case(scans_only(720), 0, "lidar", 0.05, size_m=20.0),
    "scans-covered": Case(covered, 3, "lidar", np.inf, says=("have no measured position",), nowhere_s=(3.0, 6.0)),
    "scans-and-odometry": Case(
        lone_scanner,
        0,
        "odometry",
        walls=True,
        says=("the re-simulated robot walks on a plane", "classified by the one beam of a 2-D scanner"),
    ),
    "scans-of-50-beams-and-odometry": Case(
        together(odometry, lambda log, room: add_scans(log, room, 8.0, 50, frame="base_link")),
        *(0, "odometry"),
        never=("in no map", "not levelled"),
        walls=True,
    ),
    "odometry-interrupted": Case(
        interrupted, 3, "odometry", says=("25% of 8.0 s have no measured position",), nowhere_s=(3.0, 4.9)
    ),
    "tf-odom-base_footprint": Case(tf("odom", "base_footprint"), 0, "tf", says=("log: usable\n",)),
    "tf-slashes": Case(tf("/odom", "/base_footprint"), 0, "tf"),
    "tf-prefix": Case(
        together(
            tf("robot1/odom", "robot1/base_link"), turned_scanner("robot1/laser", "robot1/base_link", "/tf_static")
        ),
        0,
        "tf",
        walls=True,
    ),
    "tf-of-two-robots": Case(
        together(tf("dog1/odom", "dog1/base_link"), tf("dog2/odom", "dog2/base_link")),
        *(0, "tf"),
        says=("tf moves 2 robots: the one of dog1/base_link is taken", "'topics.base_frame=\"dog2/base_link\"'"),
    ),
    "tf-world-trunk": Case(tf("world", "trunk"), 0, "tf"),
    "mount-on-tf": Case(
        together(tf("odom", "base_footprint"), turned_scanner("laser", "base_footprint", "/tf")), 0, "tf", walls=True
    ),
    "pose-alone": Case(pose_topics("/orb_slam3/camera_pose"), 0, "pose", says=("log: usable\n",)),
    "poses-two": Case(pose_topics("/vins/pose", "/slam/pose"), 0, None, says=("/vins/pose", "/slam/pose")),
    "truth-mirrored": Case(mirrored_truth, 0, "odometry", says=("mirror",)),
    "odometry-and-reference": Case(
        together(odometry, lambda log, room: odometry(log, room, "/mpc/reference")), 0, "odometry"
    ),
    "pose-and-truth": Case(
        pose_topics("/slam/pose", "/mocap/pose"), 0, "pose", says=("against the reference",), never=("no position",)
    ),
    "truth-of-points": Case(
        points_beside_odometry, 0, "odometry", says=("the reference has no orientation",), never=("its course,",)
    ),
    "truth-of-points-straight": Case(
        lambda log, _: points_beside_odometry(log, Westward(6.0)),
        *(0, "odometry", np.inf),
        says=("the reference has no orientation",),
        never=("its course,",),
    ),
    "truth-switched-off": Case(
        pose_topics("/slam/pose", "/mocap/pose"), 0, "pose", never=("ate_", "rpe_"), settings=("topics.reference=none",)
    ),
    "error-of-a-truth": Case(
        together(odometry, pose_topics("/vicon/error")), 0, "odometry", never=("ate_", "rpe_", "vicon")
    ),
    "amcl-beside-tf": Case(
        together(localized, pose_topics("/amcl_pose")), 0, "tf", says=("/amcl_pose is not compared",), never=("ate_",)
    ),
    "amcl-chosen-as-truth": Case(
        together(localized, pose_topics("/amcl_pose")),
        0,
        "tf",
        says=("no error is given: /amcl_pose",),
        never=("ate_", "rpe_"),
        settings=("topics.reference=/amcl_pose",),
    ),
    "amcl-beside-odometry": Case(
        together(odometry, pose_topics("/amcl_pose")),
        0,
        "odometry",
        says=("differs from /amcl_pose by 0.00 m rms once aligned (another estimate, not a reference)",),
        never=("ate_", "rpe_"),
    ),
    "odometries-beside-tf": Case(
        together(localized, odometry, lambda log, room: odometry(log, room, "/odometry/filtered")), 0, "tf"
    ),
    "chosen-source-fails": Case(
        together(tf("world", "camera"), pose_topics("/slam/pose", "/vins/pose")),
        1,
        says=(
            "--set 'topics.map_frame=\"world\"' --set 'topics.base_frame=\"camera\"'",
            "--set topics.position=/slam/pose  or  --set topics.position=/vins/pose",
            "no topic is fit to be the lidar",
        ),
        settings=("topics.position=legs",),
    ),
    "two-scanners": Case(
        two_scanners, 0, "odometry", says=("topics.lidar=/front/scan", "topics.lidar=/rear/scan", BOTH)
    ),
    "two-scanners-as-one": Case(halves, 0, "odometry", says=("79 scans",), walls=True, settings=(BOTH,)),
    "two-scanners-without-mounts": Case(
        two_scanners, 1, says=("no transform places the frame of /front/scan, /rear/scan",), settings=(BOTH,)
    ),
    "filtered-copy": Case(filtered_copy, 0, "tf", walls=True),
    "cloud-in-the-world": Case(
        together(tf("odom", "base_link"), lambda log, room: rings_of_points(log, room, "odom", fixed=True)),
        0,
        "tf",
        walls=True,
    ),
    "cloud-in-the-world-odometry": Case(
        together(odometry, lambda log, room: rings_of_points(log, room, "odom", fixed=True)), 0, "odometry", walls=True
    ),
    "cloud-in-no-frame-of-the-robot": Case(
        together(odometry, lambda log, room: rings_of_points(log, room, "map", fixed=True)),
        0,
        "odometry",
        says=("/points is in the frame map", "--set topics.lidar=/points"),
    ),
    "satellites-alone": Case(fixes("/fix"), 0, "gnss", 0.03, says=("no orientation",)),
    "satellites-beside-odometry": Case(together(fixes("/fix"), odometry), 0, "odometry", says=("differs from /fix",)),
    "velocities-alone": Case(velocities("/wheel/twist"), 0, "twist", 0.03, says=("integrated velocities", '"fixed"')),
    "velocities-of-the-world": Case(
        velocities("/velocity_local", "map", "TwistWithCovarianceStamped"), 0, "twist", 0.03
    ),
    "velocities-beside-odometry": Case(together(velocities("/wheel/twist"), odometry), 0, "odometry"),
    "velocities-wanted": Case(velocities("/cmd_vel"), 1, says=("--set topics.position=/cmd_vel",)),
    "velocities-wanted-but-chosen": Case(
        velocities("/cmd_vel"),
        0,
        "odometry",
        0.03,
        says=("integrated velocities",),
        settings=("topics.position=/cmd_vel",),
    ),
    "two-receivers": Case(
        fixes("/fix", "/gps/filtered"), 0, "fixed", np.inf, says=("--set topics.position=/gps/filtered",)
    ),
    "poses-without-orientation": Case(unoriented, 0, "pose", says=("heading is the direction of travel",), walls=0.8),
    "scans-and-truth-in-another-frame": Case(
        vicon, 0, "lidar", 0.05, says=("once aligned",), never=("no reference to compare",)
    ),
    "odometry-reset": Case(reset, 0, None, says=("positions jump 1 time, by up to 1.52 m, at 4.0 s",)),
    "clock-of-the-scanner": Case(
        other_clock,
        0,
        "odometry",
        says=("header stamps of /scan lie 120.00 s behind those of /odom; they are moved", "--stamp header"),
        never=("not in the map",),
        walls=True,
    ),
    "clock-of-another-transform": Case(
        together(tf("odom", "base_link"), another_transform, base_scans),
        0,
        "tf",
        says=("header stamps of base_link -> sonar of /tf lie", "log times are used"),
        walls=True,
    ),
    "latched-pose": Case(
        together(tf("odom", "base_link"), latched_pose, base_scans),
        0,
        "tf",
        says=("/amcl_pose: 1 stamp from outside of the log",),
        never=("no measured position",),
        walls=True,
    ),
    "no-ground": Case(
        together(odometry, lambda log, room: rings_of_points(log, room, "base_link", fixed=False)),
        0,
        "odometry",
        walls=True,
    ),
    "lidar-level": Case(turned_lidar(), 0, "odometry", never=("the floor",), walls=True),
    "lidar-upside-down": Case(turned_lidar(180.0), 0, "odometry", says=("(roll 180, pitch 0",), walls=True),
    "lidar-pitched": Case(turned_lidar(0.0, 20.0), 0, "odometry", says=("(roll 0, pitch 20 degrees)",), walls=True),
    "lidar-pitched-unlike-its-tf": Case(
        turned_lidar(0.0, 20.0, as_level=True),
        0,
        "odometry",
        says=("check the transform from velodyne to base_link",),
    ),
    "clock-set-back-odometry": Case(set_back(odometry), 3, "odometry"),
    "clock-set-back-tf": Case(set_back(tf("odom", "base_link")), 3, "tf"),
    "clock-set-back-scans": Case(
        set_back(together(odometry, lambda log, room: add_scans(log, room, 8.0, frame="base_link"))),
        *(3, "odometry"),
        says=("/odom", "/scan"),
        walls=True,
    ),
    "wheels-and-gripper": Case(
        together(odometry, joints(*WHEELS, *ARM, *GRIPPER)),
        0,
        "odometry",
        never=("was lost (", "joint_states", "torque_"),
    ),
    "legs-without-effort": Case(
        together(odometry, joints(*LEGS)),
        *(0, "odometry"),
        never=("duty_factor", "torque_", "cost_of_transport"),
        settings=("robot.model=go1",),
    ),
    "imu-upright": Case(level_imu(9.81), 0, "odometry", never=("gravity",)),
    "imu-upside-down": Case(level_imu(-9.81), 0, "odometry", says=("/imu: its orientation contradicts the gravity",)),
    "imu-without-gravity": Case(level_imu(0.0), 0, "odometry", never=("gravity",)),
    "stands-still": Case(standing, 0, None, says=("the robot stood still",), never=("nan ", "ate_aligned", " aligned")),
    "legs-with-zero-effort": Case(
        together(odometry, joints(*LEGS, zeros=True)),
        *(0, "odometry"),
        never=("duty_factor", "torque_", "cost_of_transport"),
        settings=("robot.model=go1",),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_a_replay_makes_of_it(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case, room, log = CASES[name], Room(CASES[name].size_m), Log()
    case.make(log, room)
    settings = [word for each in case.settings for word in ("--set", each)]
    path = str(log.write(tmp_path / "log"))
    code = run_cli(["replay", path, "-o", str(tmp_path / "runs"), "--no-plots", "-v", *settings])
    out, err = capsys.readouterr()
    assert code == case.code, err
    assert all(text in out + err for text in case.says), out + err
    assert not any(text in out + err for text in case.never), out + err
    if case.source is None:
        return
    run = tmp_path / "runs" / "log"
    poses = read_table(run, "poses")
    assert set(poses["source"]) == {case.source}
    if case.nowhere_s is not None:
        t_s = (poses["t_ns"] - ns(0.0)) * 1e-9
        assert not ((t_s > case.nowhere_s[0]) & (t_s < case.nowhere_s[1])).any()
        assert "No position for" in (run / "report.html").read_text()
    found_m = np.column_stack([poses["x_m"], poses["y_m"]])
    assert rms_after_alignment_m(found_m, room.way_m(poses["t_ns"])) < case.rms_m
    if case.walls:
        drawn = read_rosmap(run / "map.yaml")
        row, column = np.nonzero(drawn.blocked)
        cells_m = drawn.origin_m + drawn.cell_m * (np.column_stack([column, row]) + 0.5)
        assert (room.distance_m(cells_m) < 0.15).mean() > min(case.walls, 0.95)
        assert len(cells_m) > 200
