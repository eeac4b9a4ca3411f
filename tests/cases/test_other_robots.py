"""What a replay makes of odd logs and of robots that nobody here has seen: a row for each way in which logs differ."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.cli.main import run as run_cli
from quadlog.geometry import turned, wrap_angle
from quadlog.results.tables import read_table
from quadlog.storage.formats.ros_map import read_rosmap
from tests.lab.recordings import flip
from tests.lab.strangers import LEGS, ROS, Log, Room, add_scans, instants_s, ns, rms_after_alignment_m

Make = Callable[[Log, Room], None]


class Case(NamedTuple):
    """What makes a log, one after the other, and what must come out: source of `poses`, exit code, greatest error.

    says, never: in what is printed. walls: the least share of the occupied cells that lie on walls. mapped: it ends
    with the map, as with walls. settings: of the configuration. typed: in what `info` prints, and then `init` writes
    the configuration. damage: of the written file.
    """

    make: tuple[Make, ...]
    source: str | None = "odometry"
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    rms_m: float = 0.01
    walls: float = 0.0
    mapped: bool = False
    code: int = 0
    settings: tuple[str, ...] = ()
    size_m: float = 6.0
    nowhere_s: tuple[float, float] | None = None
    """No pose lies between these seconds of the log."""
    typed: str | None = None
    damage: Callable[[Path], None] | None = None
    later_s: Callable[[np.ndarray], np.ndarray] = np.zeros_like
    """Of seconds of the walk: how much later the log has them."""


def tf(parent: str = "odom", child: str = "base_link") -> Make:
    def add(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 20):
            log.tf(ns(t_s), parent, child, room.at(t_s))

    return add


def fixes(*topics: str) -> Make:
    """Satellite fixes at 45 degrees north, of metres east and north by the radii of the ellipsoid there."""

    def add(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 20):
            x_m, y_m, _ = room.at(t_s)
            north_deg, east_deg = 45.0 + np.degrees(y_m / 6_367_381.8), 9.0 + np.degrees(x_m / 4_517_590.9)
            fix = {"status__service": 1, "latitude": north_deg, "longitude": east_deg, "altitude": 100.0}
            for topic in topics:
                log.put(topic, ns(t_s), "sensor_msgs/msg/NavSatFix", "gps", **fix)

    return add


def velocities(topic: str, frame: str = "base_link", name: str = "TwistStamped") -> Make:
    """As a wheeled robot measures them."""

    def add(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 50):
            (x, y, yaw), (later_x, later_y, later) = room.at(t_s), room.at(t_s + 1e-3)
            ahead, left = turned(np.array(-yaw), np.array([later_x - x, later_y - y]) * 1e3)
            if frame == "map":
                ahead, left = (later_x - x) * 1e3, (later_y - y) * 1e3
            twist = {"linear": ROS.vector(ahead, left, 0), "angular": ROS.vector(0, 0, (later - yaw) * 1e3)}
            inner = "twist" if name == "TwistStamped" else "twist__twist"
            values = {f"{inner}__{part}": each for part, each in twist.items()}
            log.put(topic, ns(t_s), f"geometry_msgs/msg/{name}", frame, **values)

    return add


def odometry(log: Log, room: Room, topic: str = "/odom") -> None:
    for t_s in instants_s(8.0, 20):
        log.odometry(ns(t_s), room.at(t_s), topic)


def scans_only(beams: int) -> Make:
    return lambda log, room: add_scans(log, room, 8.0, beams)


def base_scans(log: Log, room: Room) -> None:
    """A 2-D scanner at the origin of base."""
    add_scans(log, room, 8.0, 90, frame="base_link")


def turned_scanner(frame: str, parent: str, topic: str) -> Make:
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


def pose_topics(*topics: str) -> Make:
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
    tf()(log, room)
    add_scans(log, room, 8.0, frame="base_link")
    scans = [row for row in log.messages if row[1] == "/scan"]
    log.messages += [(t_ns + 30_000_000, "/stable_scan", scan) for t_ns, _, scan in scans[5:]]


def rings_of_points(frame: str, *, fixed: bool) -> Make:
    """Clouds of walls alone, four rings that look upwards; fixed: with coordinates in the room, not about the robot."""

    def make(log: Log, room: Room) -> None:
        angle_rad = -np.pi + 2 * np.pi / 200 * np.arange(200)
        for t_s in instants_s(8.0, 10):
            range_m = room.ranges_m(t_s, 200, (0.0, 0.0, 0.0), 2 * np.pi)
            x_m, y_m, yaw_rad = room.at(t_s) if fixed else (0.0, 0.0, 0.0)
            flat_m = [x_m + range_m * np.cos(yaw_rad + angle_rad), y_m + range_m * np.sin(yaw_rad + angle_rad)]
            rings = [np.vstack([*flat_m, range_m * np.tan(up_rad)]).T for up_rad in (0.02, 0.06, 0.1, 0.14)]
            log.cloud(ns(t_s), np.concatenate(rings), frame=frame)

    return make


def turned_lidar(roll_deg: float = 0.0, pitch_deg: float = 0.0, *, as_level: bool = False) -> Make:
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
        x_m, y_m, _ = room.at(t_s)
        log.put("/vicon/dog", ns(t_s), "geometry_msgs/msg/PointStamped", "odom", point__x=x_m, point__y=y_m)


class Westward(Room):
    """A room without a turn."""

    def at(self, t_s: float) -> tuple[float, float, float]:
        return -0.5 * max(t_s - 1.0, 0.0), 0.0, np.pi


def vicon(log: Log, room: Room) -> None:
    """The body's place by motion capture, in frames of its own, beside scans."""
    for t_s in instants_s(8.0, 50):
        log.pose(ns(t_s), room.at(t_s), "/vicon/go1/go1", "world")
    add_scans(log, room, 8.0)


def stamped(later_s: float, topic: str = "", since_s: float = 0.0) -> Make:
    """Header stamps of another clock, of a topic or of all."""

    def change(log: Log, room: Room) -> None:
        for t_ns, name, content in log.messages:
            if t_ns >= ns(since_s) and topic in ("", name):
                for each in getattr(content, "transforms", [content]):
                    stamp_ns = each.header.stamp.sec * 10**9 + each.header.stamp.nanosec + round(later_s * 1e9)
                    each.header.stamp.sec, each.header.stamp.nanosec = divmod(stamp_ns, 10**9)

    return change


def mounted(log: Log, room: Room) -> None:
    """Odometry, and a scanner whose place is in tf_static."""
    odometry(log, room)
    add_scans(log, room, 8.0, 180, (0.1, 0.0, 0.0))
    log.tf(ns(0.0), "base_link", "laser", (0.1, 0.0, 0.0), 0.2, "/tf_static")


def paused(log: Log, room: Room) -> None:
    """The recorder stood still in the middle of the log for 20 s; clocks went on, the robot did not."""
    stamped(20.0, since_s=4.0)(log, room)
    log.messages = [(t_ns + 20 * 10**9 * (t_ns >= ns(4.0)), *rest) for t_ns, *rest in log.messages]


def in_bursts(log: Log, room: Room) -> None:
    """A relay that hands odometry on twice a second: log times come in bursts, stamps do not."""
    late = [(t_ns + (ns(0.0) - t_ns) % 500_000_000 * (topic == "/odom"), topic, m) for t_ns, topic, m in log.messages]
    log.messages = late


def latched(log: Log, room: Room) -> None:
    """A pose of long ago that is sent again when recording begins."""
    log.pose(ns(0.0), room.at(0.0), "/amcl_pose")
    log.messages[-1][2].header.stamp.sec -= 24


def beside(*topics: str) -> Make:
    """Topics that no one uses."""

    def make(log: Log, room: Room) -> None:
        for topic in topics:
            log.put(topic, ns(1.0), "std_msgs/msg/String", data="hello")

    return make


def nothing(log: Log, room: Room) -> None:
    """No topic."""


def cut(path: Path) -> None:
    """The recorder was killed: the last third is not there."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def flipped(path: Path) -> None:
    """One byte of the middle is another one."""
    flip(path, path.stat().st_size // 2)


ARM = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
GRIPPER = ["rh_l1", "rh_r1", "rh_l2", "rh_r2"]
WHEELS = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"]


def level_imu(gravity_mps2: float) -> Make:
    def make(log: Log, room: Room) -> None:
        odometry(log, room)
        for t_s in instants_s(8.0, 50):
            log.imu(ns(t_s), gravity_mps2)

    return make


def no_orientation(log: Log, room: Room) -> None:
    for _, topic, content in log.messages:
        if topic == "/imu":
            content.orientation = ROS.vector(0, 0, 0, 0, name="Quaternion")
            content.orientation_covariance[0] = -1.0


def standing(log: Log, room: Room) -> None:
    """Odometry and truth of a robot that never moves."""
    for t_s in instants_s(8.0, 20):
        log.odometry(ns(t_s), (1.0, 2.0, 0.5))
        log.pose(ns(t_s), (1.0, 2.0, 0.5), "/mocap/pose", "odom")


def joints(*names: str, zeros: bool = False) -> Make:
    def make(log: Log, room: Room) -> None:
        for t_s in instants_s(8.0, 50):
            log.joints(ns(t_s), list(names), efforts_nm=np.zeros(len(names)) if zeros else None)

    return make


LONG = "/camera/aligned_depth_to_color/compressedDepth/of/the/front/" + "\u76f8\u673a" + "/image_raw"
AMCL = pose_topics("/amcl_pose")
ITS_COURSE, GO1 = ("its course,",), ("robot.model=go1",)
NO_TORQUES = ("duty_factor", "torque_", "cost_of_transport")
YEAR_S = 365 * 86400.0
CASES = {
    "scans-3m": Case((scans_only(90),), "lidar", rms_m=0.05, size_m=3.0),
    "scans-20m": Case((scans_only(720),), "lidar", rms_m=0.05, size_m=20.0, mapped=True),
    "scans-covered": Case(
        (covered,), "lidar", ("have no measured position",), rms_m=np.inf, code=3, nowhere_s=(3.0, 6.0), mapped=True
    ),
    "scans-and-odometry": Case(
        (odometry, base_scans),
        says=("the re-simulated robot walks on a plane", "classified by the one beam of a 2-D scanner"),
    ),
    "scans-of-50-beams-and-odometry": Case(
        (odometry, lambda log, room: add_scans(log, room, 8.0, 50, frame="base_link")),
        walls=0.95,
        never=("in no map", "not levelled"),
    ),
    "odometry-interrupted": Case(
        (interrupted,), says=("25% of 8.0 s have no measured position",), code=3, nowhere_s=(3.0, 4.9)
    ),
    "tf-prefix": Case(
        (tf("robot1/odom", "robot1/base_link"), turned_scanner("robot1/laser", "robot1/base_link", "/tf_static")),
        "tf",
        walls=0.95,
    ),
    "mount-on-tf": Case(
        (tf("/odom", "/base_footprint"), turned_scanner("laser", "base_footprint", "/tf")), "tf", walls=0.95
    ),
    "pose-alone": Case((pose_topics("/orb_slam3/camera_pose"),), "pose", ("log: usable\n",)),
    "truth-mirrored": Case((mirrored_truth,), says=("mirror",)),
    "pose-and-truth": Case(
        (pose_topics("/slam/pose", "/mocap/pose"),), "pose", ("against the reference",), ("no position",)
    ),
    "truth-of-points": Case((points_beside_odometry,), says=("the reference has no orientation",), never=ITS_COURSE),
    "truth-of-points-straight": Case(
        (lambda log, _: points_beside_odometry(log, Westward(6.0)),),
        says=("the reference has no orientation",),
        never=ITS_COURSE,
        rms_m=np.inf,
    ),
    "amcl-beside-tf": Case((localized, AMCL), "tf", ("/amcl_pose is not compared",), ("ate_",)),
    "amcl-chosen-as-truth": Case(
        (localized, AMCL),
        "tf",
        ("no error is given: /amcl_pose",),
        ("ate_", "rpe_"),
        settings=("topics.reference=/amcl_pose",),
    ),
    "amcl-beside-odometry": Case(
        (odometry, AMCL),
        never=("ate_", "rpe_"),
        says=("differs from /amcl_pose by 0.00 m rms once aligned (another estimate, not a reference)",),
    ),
    "odometries-beside-tf": Case(
        (localized, odometry, lambda log, room: odometry(log, room, "/odometry/filtered")), "tf"
    ),
    "chosen-source-fails": Case(
        (tf("world", "camera"), pose_topics("/slam/pose", "/vins/pose")),
        None,
        code=1,
        says=(
            "--set 'topics.map_frame=\"world\"' --set 'topics.base_frame=\"camera\"'",
            "--set topics.position=/slam/pose  or  --set topics.position=/vins/pose",
            "no topic is fit to be the lidar",
        ),
        settings=("topics.position=legs",),
    ),
    "two-scanners": Case((two_scanners,), says=("topics.lidar=/front/scan", "topics.lidar=/rear/scan", BOTH)),
    "two-scanners-as-one": Case((halves,), says=("79 of 79 scans: no ground",), walls=0.95, settings=(BOTH,)),
    "two-scanners-without-mounts": Case(
        (two_scanners,), None, ("no transform places the frame of /front/scan, /rear/scan",), code=1, settings=(BOTH,)
    ),
    "filtered-copy": Case((filtered_copy,), "tf", walls=0.95),
    "cloud-in-the-world": Case((tf(), rings_of_points("odom", fixed=True)), "tf", walls=0.95),
    "cloud-in-the-world-odometry": Case((odometry, rings_of_points("odom", fixed=True)), walls=0.95),
    "cloud-in-no-frame-of-the-robot": Case(
        (odometry, rings_of_points("map", fixed=True)),
        says=("/points is in the frame map", "--set topics.lidar=/points"),
    ),
    "satellites-alone": Case((fixes("/fix"),), "gnss", ("no orientation",), rms_m=0.03),
    "satellites-beside-odometry": Case((fixes("/fix"), odometry), says=("differs from /fix",)),
    "velocities-alone": Case((velocities("/wheel/twist"),), "twist", ("integrated velocities", '"fixed"'), rms_m=0.03),
    "velocities-of-the-world": Case(
        (velocities("/velocity_local", "map", "TwistWithCovarianceStamped"),), "twist", rms_m=0.03
    ),
    "velocities-beside-odometry": Case((velocities("/wheel/twist"), odometry)),
    "velocities-wanted": Case((velocities("/cmd_vel"),), None, ("--set topics.position=/cmd_vel",), code=1),
    "velocities-wanted-but-chosen": Case(
        (velocities("/cmd_vel"),), says=("integrated velocities",), rms_m=0.03, settings=("topics.position=/cmd_vel",)
    ),
    "two-receivers": Case(
        (fixes("/fix", "/gps/filtered"),), "fixed", ("--set topics.position=/gps/filtered",), rms_m=np.inf
    ),
    "poses-without-orientation": Case((unoriented,), "pose", ("heading is the direction of travel",), walls=0.8),
    "scans-and-truth-in-another-frame": Case(
        (vicon,), "lidar", ("once aligned",), ("no reference to compare",), rms_m=0.05, mapped=True
    ),
    "no-ground": Case((odometry, rings_of_points("base_link", fixed=False)), walls=0.95),
    "lidar-level": Case((turned_lidar(),), never=("the floor",), walls=0.95),
    "lidar-upside-down": Case((turned_lidar(180.0),), says=("(roll 180, pitch 0",), walls=0.95),
    "lidar-pitched": Case((turned_lidar(0.0, 20.0),), says=("(roll 0, pitch 20 degrees)",), walls=0.95),
    "lidar-pitched-unlike-its-tf": Case(
        (turned_lidar(0.0, 20.0, as_level=True),), says=("check the transform from velodyne to base_link",), mapped=True
    ),
    "wheels-and-gripper": Case(
        (odometry, joints(*WHEELS, *ARM, *GRIPPER)), never=("was lost (", "joint_states", "torque_")
    ),
    "legs-without-effort": Case((odometry, joints(*LEGS)), never=NO_TORQUES, settings=GO1),
    "legs-with-zero-effort": Case((odometry, joints(*LEGS, zeros=True)), never=NO_TORQUES, settings=GO1),
    "imu-frozen": Case((level_imu(9.81),), says=("/imu: its orientation is the same",), never=("gravity",)),
    "imu-of-rates": Case((level_imu(9.81), no_orientation), says=("/imu: its messages hold no",)),
    "imu-upside-down": Case((level_imu(-9.81),), says=("/imu: its orientation contradicts the gravity",)),
    "imu-without-gravity": Case((level_imu(0.0),), never=("gravity",)),
    "stands-still": Case((standing,), None, ("the robot stood still",), ("nan ", "ate_aligned", " aligned")),
    "clock-set-back": Case(
        (odometry, base_scans, stamped(-3.0, since_s=5.0)), says=("/odom", "/scan"), walls=0.95, code=3
    ),
    # What info, init and a replay with init's configuration make of odd logs.
    "sound": Case((mounted,), never=("warning: header", "lost:"), walls=0.95, typed="/scan"),
    "scans-two-seconds-behind": Case(
        (mounted, stamped(-2.0, "/scan")), says=("they are moved", "--stamp header"), walls=0.95, typed="/scan"
    ),
    "all-a-year-behind": Case(
        (mounted, stamped(-YEAR_S)),
        never=("--stamp log",),
        walls=0.95,
        typed="/scan",
        later_s=lambda t_s: 0 * t_s - YEAR_S,
    ),
    "latched-pose": Case(
        (mounted, latched),
        says=("/amcl_pose: 1 stamp from outside of the log",),
        never=("no measured position",),
        walls=0.95,
        typed="/scan",
    ),
    "bursts": Case((mounted, in_bursts), walls=0.95, typed="/scan"),
    "pause-of-20-s": Case(
        (mounted, paused),
        says=("no measured position",),
        walls=0.95,
        code=3,
        typed="/scan",
        later_s=lambda t_s: 20.0 * (t_s >= 4),
    ),
    "long-and-wide-names": Case((mounted, beside(LONG, "/" + "x" * 60)), walls=0.95, typed="/" + "x" * 60),
    "nothing": Case((nothing,), None, code=1, typed="no topics"),
    "nothing-of-use": Case(
        (beside("/chatter"),), None, ("nothing to replay",), ("nothing readable",), code=1, typed="chatter"
    ),
    "cut": Case((mounted,), says=("lost:",), walls=0.95, code=3, typed="/scan", damage=cut),
    "flipped": Case((mounted,), says=("lost:",), walls=0.95, code=3, typed="/scan", damage=flipped),
}


@pytest.mark.parametrize("name", CASES)
def test_what_a_replay_makes_of_it(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case, room, log = CASES[name], Room(CASES[name].size_m), Log()
    for make in case.make:
        make(log, room)
    path = log.write(tmp_path / "log", chunk_size=20_000)
    if case.damage is not None:
        case.damage(path)

    def type_in(command: str, *words: str) -> tuple[int, str]:
        code = run_cli([command, str(path), *words])
        printed = "".join(capsys.readouterr())
        assert "Traceback" not in printed
        return code, printed

    words = [word for each in case.settings for word in ("--set", each)]
    if case.typed is not None:
        found = 3 if case.damage else 0
        code, printed = type_in("info")
        assert (code, case.typed in printed) == (found, True), printed
        assert type_in("init", "-o", str(tmp_path / "quadlog.toml"))[0] == found
        words += ["-c", str(tmp_path / "quadlog.toml")]
    words += ["--until", "map"] if case.walls or case.mapped else []
    code, printed = type_in("replay", "-o", str(tmp_path / "runs"), "--no-plots", "-v", *words)
    assert code == case.code, printed
    assert all(text in printed for text in case.says), printed
    assert not any(text in printed for text in case.never), printed
    if case.source is not None:
        check_truth(tmp_path / "runs" / "log", case, room)


def check_truth(run: Path, case: Case, room: Room) -> None:
    """Positions are those of the walk, also headings where they are sent, and what is occupied is a wall."""
    poses = read_table(run, "poses")
    assert set(poses["source"]) == {case.source}
    if case.nowhere_s is not None:
        t_s = (poses["t_ns"] - ns(0.0)) * 1e-9
        assert not ((t_s > case.nowhere_s[0]) & (t_s < case.nowhere_s[1])).any()
        assert "No position for" in (run / "report.html").read_text()
    walk_s = np.arange(0.0, 8.0, 0.001)
    t_s = np.interp((poses["t_ns"] - ns(0.0)) * 1e-9, walk_s + case.later_s(walk_s), walk_s)
    true = np.array([room.at(each) for each in t_s])
    assert rms_after_alignment_m(np.column_stack([poses["x_m"], poses["y_m"]]), true[:, :2]) < case.rms_m
    if case.typed is not None:
        assert np.abs(wrap_angle(poses["yaw_rad"] - true[:, 2])).max() < np.radians(2.0)
    if case.walls:
        drawn = read_rosmap(run / "map.yaml")
        row, column = np.nonzero(drawn.blocked)
        cells_m = drawn.origin_m + drawn.cell_m * (np.column_stack([column, row]) + 0.5)
        assert (room.distance_m(cells_m) < 0.15).mean() > case.walls
        assert len(cells_m) > (200 if case.typed is None else 100)
