"""A second and a half of a walk with a lidar, whose clouds are changed before they are written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.simulation.sensors.scene import Cylinder, Obstacle
from quadlog.simulation.synthetic.follow import synthesize
from quadlog.simulation.synthetic.recording import IMU_TOPIC, LIDAR_TOPIC, ROBOT_TRUTH_TOPIC, TF_STATIC_TOPIC
from quadlog.simulation.synthetic.ros_encoding import ENCODED, POINT, RosEncoder
from tests.lab.recordings import Row
from tests.lab.strangers import ROS

RECORDING = synthesize(seed=0, duration_s=1.6, azimuth_steps=240)
SCANS = 16
WANTED = (TF_STATIC_TOPIC, IMU_TOPIC, ROBOT_TRUTH_TOPIC, LIDAR_TOPIC)
CLOUD = "sensor_msgs/msg/PointCloud2"
SOURCES = ["--until", "map", "--set", f"topics.position={ROBOT_TRUTH_TOPIC}", "--set", "topics.target=ahead"]
"""Of a replay of the recording, as far as its maps."""

Points = np.ndarray


def sensed(scan: Any) -> Points:
    points = np.empty(len(scan.cloud.xyz_m), POINT)
    for axis, name in enumerate("xyz"):
        points[name] = scan.cloud.xyz_m[:, axis]
    points["intensity"], points["ring"] = scan.intensity, scan.cloud.ring
    points["time"] = scan.cloud.offset_ns * 1e-9
    return points


def encoded(points: Points, stamp_ns: int, frame: str = "lidar", claimed: int | None = None) -> bytes:
    """A PointCloud2 of any fields; claimed: how many points it says it has."""
    n = len(points) if claimed is None else claimed
    return ROS.serialise(ROS.cloud(stamp_ns, points, frame, width=n, row_step=n * points.dtype.itemsize))


Change = Callable[[int, int, Any], tuple[int, Any]]
"""Of the n-th cloud: log time and scan -> log time, and scan or payload (None: left out)."""


def rows(change: Change = lambda n, log_ns, scan: (log_ns, scan), beside_ns: int = 0) -> list[Row]:
    """The messages in the order in which they are written; beside_ns is added to all stamps but the clouds'."""
    encoder, made, n = RosEncoder(), [], 0
    for topic, log_ns, content in RECORDING.messages():
        if topic not in WANTED:
            continue
        type_name, changed = ENCODED[type(content)][0], content
        if topic == LIDAR_TOPIC:
            log_ns, changed = change(n, log_ns, content)
            n += 1
        elif beside_ns:
            changed = replace(content, stamp_ns=content.stamp_ns + beside_ns)
        if changed is not None:
            payload = changed if isinstance(changed, bytes) else encoder.encode(changed)
            made.append((topic, log_ns, type_name, payload))
    return made


def stamped(scan: Any, stamp_ns: int) -> Any:
    return replace(scan, cloud=replace(scan.cloud, stamp_ns=stamp_ns))


def from_obstacle(obstacle: Obstacle, places_m: np.ndarray) -> np.ndarray:
    """How far places (N, 2) are from an obstacle, 0 inside of it."""
    away_m = places_m - [obstacle.x_m, obstacle.y_m]
    if isinstance(obstacle, Cylinder):
        return np.maximum(np.linalg.norm(away_m, axis=1) - obstacle.radius_m, 0)
    cos, sin = np.cos(obstacle.yaw_rad), np.sin(obstacle.yaw_rad)
    own_m = np.abs(away_m @ np.array([[cos, -sin], [sin, cos]]))
    return np.linalg.norm(np.maximum(own_m - np.array([obstacle.length_m, obstacle.width_m]) / 2, 0), axis=1)
