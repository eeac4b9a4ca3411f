"""Encode quadlog's messages as ROS 2 payloads, with the definitions that the recording embeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.messages import Float, Imu, JointStates, Message, Odometry, Pose, Transforms, UwbRanges
from quadlog.recordings.decoders.ros_messages import BUNDLED, HEADER_FIELD
from quadlog.simulation.sensors.lidar import SimulatedScan

Fields = dict[str, Any]
"""Field values of a message by name."""
LINKTRACK = "nlink_parser/msg/LinktrackTagframe0"

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
"""A velodyne driver's point: 22 bytes, time in seconds relative to the header's stamp."""

_POINT_FIELD_TYPES = {"f4": 7, "u2": 4}
_LINKTRACK_TAG_ROLE = 2
_LINKTRACK_ANCHORS = 8
_LINKTRACK_VOLTAGE = 4.9


class RosEncoder:
    """Encodes messages as CDR. LinkTrack frames carry a header, as in the ROS 2 port of their driver."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        package, _, name = LINKTRACK.split("/")
        text = (BUNDLED / package / "msg" / f"{name}.msg").read_text(encoding="utf-8")
        self._store.register(get_types_from_msg(HEADER_FIELD + text, LINKTRACK))

    def definition(self, type_name: str) -> str:
        """The text that the recording embeds for a type."""
        return self._store.generate_msgdef(type_name, ros_version=2)[0]

    def encode(self, message: Message | SimulatedScan) -> bytes:
        """The payload of a message."""
        type_name, fields = ENCODED[type(message)]
        return bytes(self._store.serialize_cdr(self._make(type_name, fields(message)), type_name))

    def _make(self, type_name: str, fields: Fields) -> Any:
        """A message from its fields, nested messages as dictionaries too; arrays that are not given are zeros."""
        values = {}
        described: Any = self._store.fielddefs[type_name][1]
        for name, (kind, of) in described:
            if kind == Nodetype.NAME:
                values[name] = self._make(of, fields[name])
            elif kind == Nodetype.ARRAY and name not in fields:
                (_, (dtype, _)), size = of
                values[name] = np.zeros(size, dtype=dtype)
            elif kind == Nodetype.SEQUENCE and of[0][0] == Nodetype.NAME:
                values[name] = [self._make(of[0][1], each) for each in fields[name]]
            else:
                values[name] = fields[name]
        return self._store.types[type_name](**values)


def _header(stamp_ns: int | None, frame_id: str) -> Fields:
    assert stamp_ns is not None
    return {
        "stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9},
        "frame_id": frame_id,
    }


def _named(values: Float, names: str = "xyz") -> Fields:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _pose_fields(pose: Pose | Odometry) -> Fields:
    return {"position": _named(pose.position_m), "orientation": _named(pose.quat_xyzw, "xyzw")}


def _scan(scan: SimulatedScan) -> Fields:
    cloud = scan.cloud
    points = np.empty(len(cloud.xyz_m), dtype=POINT)
    for axis, name in enumerate("xyz"):
        points[name] = cloud.xyz_m[:, axis]
    assert cloud.offset_ns is not None
    points["intensity"], points["ring"], points["time"] = scan.intensity, cloud.ring, cloud.offset_ns * 1e-9
    assert POINT.fields is not None
    return {
        "header": _header(cloud.stamp_ns, cloud.frame_id),
        "height": 1,
        "width": len(points),
        "fields": [
            {"name": name, "offset": field[1], "datatype": _POINT_FIELD_TYPES[field[0].str[1:]], "count": 1}
            for name, field in POINT.fields.items()
        ],
        "is_bigendian": False,
        "point_step": POINT.itemsize,
        "row_step": POINT.itemsize * len(points),
        "data": points.view(np.uint8).reshape(-1),
        "is_dense": True,
    }


def _uwb_ranges(ranges: UwbRanges) -> Fields:
    """The module's own position, velocity and IMU fields stay zero."""
    assert ranges.stamp_ns is not None
    distances = np.zeros(_LINKTRACK_ANCHORS, dtype=np.float32)  # 0: no range
    distances[ranges.anchor] = ranges.range_m
    clock_ms = ranges.stamp_ns // 10**6 % 2**32
    return {
        "header": _header(ranges.stamp_ns, "map"),
        "role": _LINKTRACK_TAG_ROLE,
        "id": ranges.tag,
        "local_time": clock_ms,
        "system_time": clock_ms,
        "voltage": _LINKTRACK_VOLTAGE,
        "dis_arr": distances,
    }


def _imu(imu: Imu) -> Fields:
    assert imu.quat_xyzw is not None
    return {
        "header": _header(imu.stamp_ns, imu.frame_id),
        "orientation": _named(imu.quat_xyzw, "xyzw"),
        "angular_velocity": _named(imu.angular_radps),
        "linear_acceleration": _named(imu.linear_mps2),
    }


def _pose(pose: Pose) -> Fields:
    return {"header": _header(pose.stamp_ns, pose.frame_id), "pose": _pose_fields(pose)}


def _odometry(odometry: Odometry) -> Fields:
    twist = {"linear": _named(odometry.linear_mps), "angular": _named(odometry.angular_radps)}
    return {
        "header": _header(odometry.stamp_ns, odometry.frame_id),
        "child_frame_id": odometry.child_frame_id,
        "pose": {"pose": _pose_fields(odometry)},
        "twist": {"twist": twist},
    }


def _transforms(transforms: Transforms) -> Fields:
    return {
        "transforms": [
            {
                "header": _header(pose.stamp_ns, pose.frame_id),
                "child_frame_id": pose.child_frame_id,
                "transform": {"translation": _named(pose.position_m), "rotation": _named(pose.quat_xyzw, "xyzw")},
            }
            for pose in transforms.transforms
        ]
    }


_LEGS = ("FL", "FR", "RL", "RR")
_JOINT_NAMES = [
    *(f"{leg}_{joint}_joint" for leg in _LEGS for joint in ("hip", "thigh", "calf")),
    *(f"{leg}_foot" for leg in _LEGS),
]
"""As in Unitree's robot descriptions; the effort of a foot is its force, as some drivers have it."""


def _joint_states(joints: JointStates) -> Fields:
    return {
        "header": _header(joints.stamp_ns, ""),
        "name": _JOINT_NAMES,
        "position": np.concatenate([joints.position_rad, np.zeros(4)]),
        "velocity": np.concatenate([joints.velocity_radps, np.zeros(4)]),
        "effort": np.concatenate([joints.torque_nm, joints.foot_force_n]),
    }


ENCODED: dict[type, tuple[str, Callable[[Any], Fields]]] = {
    SimulatedScan: ("sensor_msgs/msg/PointCloud2", _scan),
    UwbRanges: (LINKTRACK, _uwb_ranges),
    Imu: ("sensor_msgs/msg/Imu", _imu),
    Odometry: ("nav_msgs/msg/Odometry", _odometry),
    Pose: ("geometry_msgs/msg/PoseStamped", _pose),
    Transforms: ("tf2_msgs/msg/TFMessage", _transforms),
    JointStates: ("sensor_msgs/msg/JointState", _joint_states),
}
"""Of each message its type's name, and its fields' values."""
