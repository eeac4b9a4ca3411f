"""Logs of robots that are not ours: a body drives an ellipse in a room, and whatever sensors it has look on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.recordings.decoders.ros_messages import BUNDLED

STORE = get_typestore(Stores.ROS2_HUMBLE)
for _driver in ("uwb_driver", "unitree_go"):
    for _path in sorted((BUNDLED / _driver / "msg").glob("*.msg")):
        STORE.register(get_types_from_msg(_path.read_text(), f"{_driver}/msg/{_path.stem}"))
START_NS = 1_700_000_000_000_000_000
SPEED_MPS = 0.4

Array = np.ndarray


def message(name: str, *values: Any) -> Any:
    """A ROS 2 message from its fields in order."""
    return STORE.types[name](*values)


def zeros(name: str) -> Any:
    """A message of zeros."""
    return STORE.types[name](*(_zeros(int(kind), what) for _, (kind, what) in STORE.fielddefs[name][1]))


def _zeros(kind: int, what: Any) -> Any:
    if kind == 1:
        return 0.0 if what[0].startswith("float") else 0
    if kind == 2:
        return zeros(what)
    (inner, of), count = what
    return np.zeros(count, of[0]) if int(inner) == 1 else [_zeros(int(inner), of) for _ in range(count)]


def header(t_ns: int, frame: str) -> Any:
    return message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", t_ns // 10**9, t_ns % 10**9), frame)


def vector(x: float, y: float, z: float) -> Any:
    return message("geometry_msgs/msg/Vector3", float(x), float(y), float(z))


def quaternion(yaw_rad: float) -> Any:
    return message("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw_rad / 2)), float(np.cos(yaw_rad / 2)))


def pose(x_m: float, y_m: float, yaw_rad: float) -> Any:
    point = message("geometry_msgs/msg/Point", float(x_m), float(y_m), 0.0)
    return message("geometry_msgs/msg/Pose", point, quaternion(yaw_rad))


class Log:
    """Messages of a recording that is written as MCAP."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, str, Any]] = []

    def add(self, topic: str, t_ns: int, content: Any) -> None:
        self.messages.append((int(t_ns), topic, content))

    def tf(
        self, t_ns: int, parent: str, child: str, at: tuple[float, float, float], z_m: float = 0.0, topic: str = "/tf"
    ) -> None:
        """at: x_m, y_m, yaw_rad of the child in its parent."""
        transform = message("geometry_msgs/msg/Transform", vector(at[0], at[1], z_m), quaternion(at[2]))
        stamped = message("geometry_msgs/msg/TransformStamped", header(t_ns, parent), child, transform)
        self.add(topic, t_ns, message("tf2_msgs/msg/TFMessage", [stamped]))

    def odometry(
        self,
        t_ns: int,
        at: tuple[float, float, float],
        topic: str = "/odom",
        frame: str = "odom",
        child: str = "base_link",
        twist: tuple[float, ...] = (0.0,) * 6,
    ) -> None:
        """twist: velocity and angular velocity of the child."""
        nothing = np.zeros(36)
        moving = message("geometry_msgs/msg/Twist", vector(*twist[:3]), vector(*twist[3:]))
        with_covariance = message("geometry_msgs/msg/TwistWithCovariance", moving, nothing)
        where = message("geometry_msgs/msg/PoseWithCovariance", pose(*at), nothing)
        odometry = message("nav_msgs/msg/Odometry", header(t_ns, frame), child, where, with_covariance)
        self.add(topic, t_ns, odometry)

    def pose(self, t_ns: int, at: tuple[float, float, float], topic: str, frame: str = "map") -> None:
        self.add(topic, t_ns, message("geometry_msgs/msg/PoseStamped", header(t_ns, frame), pose(*at)))

    def scan(self, t_ns: int, ranges_m: Array, span_rad: float, topic: str = "/scan", frame: str = "laser") -> None:
        step_rad = span_rad / len(ranges_m)
        angles = (-span_rad / 2, span_rad / 2 - step_rad, step_rad)
        returns = ranges_m.astype(np.float32), np.zeros(0, np.float32)
        name = "sensor_msgs/msg/LaserScan"
        self.add(topic, t_ns, message(name, header(t_ns, frame), *angles, 0.0, 0.1, 0.05, 30.0, *returns))

    def cloud(self, t_ns: int, xyz_m: Array, topic: str = "/points", frame: str = "velodyne") -> None:
        fields = [message("sensor_msgs/msg/PointField", name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
        data = np.frombuffer(xyz_m.astype("<f4").tobytes(), np.uint8)
        size = (1, len(xyz_m), fields, False, 12, 12 * len(xyz_m), data, True)
        self.add(topic, t_ns, message("sensor_msgs/msg/PointCloud2", header(t_ns, frame), *size))

    def imu(self, t_ns: int, gravity_mps2: float) -> None:
        """A level IMU that measures so much along its z axis."""
        nothing = np.zeros(9)
        turned, rates, pulls = quaternion(0.0), vector(0, 0, 0), vector(0, 0, gravity_mps2)
        values = (header(t_ns, "imu"), turned, nothing, rates, nothing, pulls, nothing)
        self.add("/imu", t_ns, message("sensor_msgs/msg/Imu", *values))

    def range(self, t_ns: int, topic: str, range_m: float, limits_m: tuple[float, float] = (0.0, 0.0)) -> None:
        """A sensor_msgs/Range, whose topic names tag and anchor."""
        self.add(topic, t_ns, message("sensor_msgs/msg/Range", header(t_ns, ""), 0, 0.0, *limits_m, range_m))

    def joints(
        self, t_ns: int, names: list[str], angles_rad: Array | None = None, efforts_nm: Array | None = None
    ) -> None:
        """Angles alone unless efforts are given."""
        angles_rad = np.full(len(names), 0.1) if angles_rad is None else angles_rad
        efforts_nm = np.zeros(0) if efforts_nm is None else efforts_nm
        values = (names, angles_rad, np.zeros(len(efforts_nm)), efforts_nm)
        self.add("/joint_states", t_ns, message("sensor_msgs/msg/JointState", header(t_ns, ""), *values))

    def write(self, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
        """The recording as a folder of ROS 2."""
        with Writer(path, version=9, storage_plugin=storage) as writer:
            connections: dict[str, Any] = {}
            for t_ns, topic, content in sorted(self.messages, key=lambda row: row[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, content.__msgtype__, typestore=STORE)
                writer.write(connections[topic], t_ns, STORE.serialize_cdr(content, content.__msgtype__))
        return path


class Room:
    """A room of size_m by .8 size_m with boxes along its walls, and a drive round an ellipse in it.

    Positions are those from the start of the drive; the robot stands for the first second.
    """

    def __init__(self, size_m: float, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.size_m = size_m
        half_m = np.array([0.5, 0.4]) * size_m
        outlines = [half_m * [[-1, -1], [1, -1], [1, 1], [-1, 1]]]
        for turn_rad in rng.uniform(0, 2 * np.pi, 6):
            center_m = size_m * np.array([0.43 * np.cos(turn_rad), 0.33 * np.sin(turn_rad)])
            outlines.append(center_m + rng.uniform(0.02, 0.05, 2) * size_m * [[-1, -1], [1, -1], [1, 1], [-1, 1]])
        walls_m = np.concatenate([np.hstack([corners, np.roll(corners, -1, axis=0)]) for corners in outlines])
        self.walls_m = walls_m - [0.26 * size_m, 0, 0.26 * size_m, 0]

    def at(self, t_s: float) -> tuple[float, float, float]:
        """x_m, y_m, yaw_rad of the robot t_s after the start."""
        a_m, b_m = 0.26 * self.size_m, 0.18 * self.size_m
        turn_rad = SPEED_MPS * max(t_s - 1.0, 0.0) / ((a_m + b_m) / 2)
        along = (-a_m * np.sin(turn_rad), b_m * np.cos(turn_rad))
        return a_m * np.cos(turn_rad) - a_m, b_m * np.sin(turn_rad), float(np.arctan2(along[1], along[0]))

    def way_m(self, t_ns: Array) -> Array:
        """(N, 2) positions at instants (N,)."""
        return np.array([self.at((t - START_NS) * 1e-9)[:2] for t in t_ns.tolist()])

    def ranges_m(self, t_s: float, beams: int, mount: tuple[float, float, float], span_rad: float) -> Array:
        """(beams,) distances to the walls, with 1 cm of noise; mount: x_m, y_m, yaw_rad of the scanner in base."""
        x_m, y_m, yaw_rad = self.at(t_s)
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        eye_m = np.array([x_m + cos * mount[0] - sin * mount[1], y_m + sin * mount[0] + cos * mount[1]])
        angle_rad = yaw_rad + mount[2] - span_rad / 2 + span_rad / beams * np.arange(beams)
        ray = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)[:, None]
        from_m, along_m = self.walls_m[:, :2] - eye_m, self.walls_m[:, 2:] - self.walls_m[:, :2]
        with np.errstate(divide="ignore", invalid="ignore"):
            across = _cross(ray, along_m)
            range_m, share = _cross(from_m, along_m) / across, _cross(from_m, ray) / across
        hit = np.where((range_m > 0) & (share >= 0) & (share <= 1), range_m, np.inf).min(axis=1)
        return hit + np.random.default_rng(round(t_s * 1e6)).normal(0, 0.01, beams)

    def distance_m(self, places_m: Array) -> Array:
        """(N,) distances of places (N, 2) to the nearest wall."""
        start_m, along_m = self.walls_m[:, :2], self.walls_m[:, 2:] - self.walls_m[:, :2]
        away_m = places_m[:, None] - start_m
        share = np.clip((away_m * along_m).sum(axis=2) / (along_m**2).sum(axis=1), 0, 1)
        return np.linalg.norm(away_m - share[..., None] * along_m, axis=2).min(axis=1)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def instants_s(duration_s: float, rate_hz: float) -> list[float]:
    return [k / rate_hz for k in range(round(duration_s * rate_hz))]


def ns(t_s: float) -> int:
    return START_NS + round(t_s * 1e9)


def add_scans(
    log: Log,
    room: Room,
    duration_s: float,
    beams: int = 360,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **where: str,
) -> None:
    """LaserScans at 10 Hz all round; where: topic and frame."""
    for t_s in instants_s(duration_s, 10):
        log.scan(ns(t_s), room.ranges_m(t_s, beams, mount, 2 * np.pi), 2 * np.pi, **where)


def rms_after_alignment_m(found_m: Array, true_m: Array) -> float:
    """RMS distance of positions (N, 2) after the best turn and shift in the plane."""
    a, b = found_m - found_m.mean(axis=0), true_m - true_m.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.sqrt(((a @ turn - b) ** 2).sum(axis=1).mean()))
