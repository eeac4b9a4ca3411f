"""Logs of robots that are not ours: a body drives an ellipse in a room, and whatever sensors it has look on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.lab.messages import At, Ros, yawed
from tests.lab.recordings import Row, written

ROS = Ros()
START_NS = 1_700_000_000_000_000_000
SPEED_MPS = 0.4
LEGS = [f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")]

Array = np.ndarray


class Log:
    """Messages of a recording that is to be written."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, str, Any]] = []

    def add(self, topic: str, t_ns: int, content: Any) -> None:
        self.messages.append((int(t_ns), topic, content))

    def put(self, topic: str, t_ns: int, name: str, frame: str | None = None, /, **values: Any) -> None:
        """A message of a type by the values of its fields; with the frame, it has a header."""
        header = {} if frame is None else {"header": ROS.header(t_ns, frame)}
        self.add(topic, t_ns, ROS.make(name, **header, **values))

    def tf(self, t_ns: int, parent: str, child: str, at: At, z_m: float = 0.0, topic: str = "/tf") -> None:
        """at: of the child in its parent."""
        self.add(topic, t_ns, ROS.tf(ROS.transform(t_ns, parent, child, (*at[:2], z_m), yawed(at[2]))))

    def odometry(self, t_ns: int, at: At, topic: str = "/odom", **named: Any) -> None:
        self.add(topic, t_ns, ROS.odometry(t_ns, at, **named))

    def pose(self, t_ns: int, at: At, topic: str, frame: str = "map") -> None:
        self.put(topic, t_ns, "geometry_msgs/msg/PoseStamped", frame, pose=ROS.pose((*at[:2], 0), yawed(at[2])))

    def scan(self, t_ns: int, ranges_m: Array, span_rad: float, topic: str = "/scan", frame: str = "laser") -> None:
        step_rad = span_rad / len(ranges_m)
        angles = {"angle_min": -span_rad / 2, "angle_max": span_rad / 2 - step_rad, "angle_increment": step_rad}
        values = {"scan_time": 0.1, "range_min": 0.05, "range_max": 30.0, "ranges": ranges_m}
        self.put(topic, t_ns, "sensor_msgs/msg/LaserScan", frame, **angles, **values)

    def cloud(self, t_ns: int, xyz_m: Array, topic: str = "/points", frame: str = "velodyne") -> None:
        self.add(topic, t_ns, ROS.cloud(t_ns, xyz_m, frame))

    def imu(self, t_ns: int, gravity_mps2: float) -> None:
        """A level IMU that measures so much along its z axis."""
        self.put("/imu", t_ns, "sensor_msgs/msg/Imu", "imu", orientation__w=1.0, linear_acceleration__z=gravity_mps2)

    def range(self, t_ns: int, topic: str, range_m: float, limits_m: tuple[float, float] = (0.0, 0.0)) -> None:
        """A sensor_msgs/Range, whose topic names tag and anchor."""
        self.add(topic, t_ns, ROS.range(t_ns, range_m, limits_m))

    def joints(
        self, t_ns: int, names: list[str], angles_rad: Array | None = None, efforts_nm: Array | None = None
    ) -> None:
        """Angles alone unless efforts are given."""
        efforts_nm = np.zeros(0) if efforts_nm is None else efforts_nm
        values = {"position": np.full(len(names), 0.1) if angles_rad is None else angles_rad, "effort": efforts_nm}
        values |= {"name": names, "velocity": np.zeros(len(efforts_nm))}
        self.put("/joint_states", t_ns, "sensor_msgs/msg/JointState", "", **values)

    def rows(self) -> list[Row]:
        """What is written."""
        ordered = sorted(self.messages, key=lambda row: row[0])
        return [(topic, t_ns, each.__msgtype__, ROS.serialise(each)) for t_ns, topic, each in ordered]

    def write(self, path: Path, **options: Any) -> Path:
        """A recording in the container that the path's extension names."""
        return written(path, self.rows(), **options)


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

    def at(self, t_s: float) -> At:
        """x_m, y_m, yaw_rad of the robot t_s after the start."""
        a_m, b_m = 0.26 * self.size_m, 0.18 * self.size_m
        turn_rad = SPEED_MPS * max(t_s - 1.0, 0.0) / ((a_m + b_m) / 2)
        along = (-a_m * np.sin(turn_rad), b_m * np.cos(turn_rad))
        return a_m * np.cos(turn_rad) - a_m, b_m * np.sin(turn_rad), float(np.arctan2(along[1], along[0]))

    def ranges_m(self, t_s: float, beams: int, mount: At, span_rad: float) -> Array:
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
    log: Log, room: Room, duration_s: float, beams: int = 360, mount: At = (0.0, 0.0, 0.0), **where: str
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
