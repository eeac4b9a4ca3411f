"""From quadlog's messages to ROS payloads, ROS 1 and ROS 2, with the definitions that go into the recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.messages import Float, Imu, Message, Odometry, Pose, Transforms, UwbRanges
from quadlog.recordings.decoders.ros_messages import BUNDLED, HEADER_FIELD
from quadlog.simulation.sensors.lidar import SimulatedScan

LINKTRACK = "nlink_parser/msg/LinktrackTagframe0"

TYPE_NAMES: dict[type, str] = {
    SimulatedScan: "sensor_msgs/msg/PointCloud2",
    UwbRanges: LINKTRACK,
    Imu: "sensor_msgs/msg/Imu",
    Odometry: "nav_msgs/msg/Odometry",
    Pose: "geometry_msgs/msg/PoseStamped",
    Transforms: "tf2_msgs/msg/TFMessage",
}

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
"""A velodyne driver's point: 22 bytes, time in seconds relative to the header's stamp."""

_TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"
_POINT_FIELD_TYPES = {"f4": 7, "u2": 4}
_LINKTRACK_TAG_ROLE = 2
_LINKTRACK_ANCHORS = 8
_LINKTRACK_VOLTAGE = 4.9


class Definition(NamedTuple):
    """A type's definition as text, and its digest: MD5 in ROS 1, RIHS01 in ROS 2."""

    text: str
    digest: str


class RosEncoder:
    """Encodes for one version of ROS. LinkTrack frames carry a header in both, as in the ROS 2 port."""

    def __init__(self, version: Literal[1, 2]) -> None:
        self.version = version
        self._store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
        package, _, name = LINKTRACK.split("/")
        text = (BUNDLED / package / "msg" / f"{name}.msg").read_text(encoding="utf-8")
        self._store.register(get_types_from_msg(HEADER_FIELD + text, LINKTRACK))
        if version == 1:
            # rosbags knows tf's own package in ROS 2 only.
            self._store.register(get_types_from_msg(_TF_MESSAGE, TYPE_NAMES[Transforms]))
        self._fill: dict[type, Callable[[Any, int], Any]] = {
            SimulatedScan: self._scan,
            UwbRanges: self._uwb_ranges,
            Imu: self._imu,
            Odometry: self._odometry,
            Pose: self._pose,
            Transforms: self._transforms,
        }

    def definition(self, type_name: str) -> Definition:
        """What the recording embeds for a type."""
        text, md5 = self._store.generate_msgdef(type_name, ros_version=self.version)
        return Definition(text, md5 if self.version == 1 else self._store.hash_rihs01(type_name))

    def encode(self, message: Message | SimulatedScan, sequence: int) -> bytes:
        """The payload of a message, the sequence-th of its topic (ROS 1 headers say so)."""
        filled, type_name = self._fill[type(message)](message, sequence), TYPE_NAMES[type(message)]
        if self.version == 1:
            return bytes(self._store.serialize_ros1(filled, type_name))
        return bytes(self._store.serialize_cdr(filled, type_name))

    def _make(self, type_name: str, **fields: Any) -> Any:
        return self._store.types[type_name](**fields)

    def _header(self, stamp_ns: int | None, frame_id: str, sequence: int) -> Any:
        assert stamp_ns is not None
        stamp = self._make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        numbered = {"seq": sequence} if self.version == 1 else {}
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id, **numbered)

    def _vector(self, xyz: Float, kind: str = "Vector3") -> Any:
        x, y, z = (float(each) for each in xyz)
        return self._make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _quaternion(self, quat_xyzw: Float) -> Any:
        x, y, z, w = (float(each) for each in quat_xyzw)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _scan(self, scan: SimulatedScan, sequence: int) -> Any:
        cloud = scan.cloud
        points = np.empty(len(cloud.xyz_m), dtype=POINT)
        for axis, name in enumerate("xyz"):
            points[name] = cloud.xyz_m[:, axis]
        points["intensity"], points["ring"] = scan.intensity, cloud.ring
        assert cloud.offset_ns is not None
        points["time"] = cloud.offset_ns * 1e-9
        return self._make(
            TYPE_NAMES[SimulatedScan],
            header=self._header(cloud.stamp_ns, cloud.frame_id, sequence),
            height=1,
            width=len(points),
            fields=self._point_fields(),
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * len(points),
            data=points.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def _point_fields(self) -> list[Any]:
        assert POINT.fields is not None
        return [
            self._make(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=field[1],
                datatype=_POINT_FIELD_TYPES[field[0].str[1:]],
                count=1,
            )
            for name, field in POINT.fields.items()
        ]

    def _uwb_ranges(self, ranges: UwbRanges, sequence: int) -> Any:
        assert ranges.stamp_ns is not None
        distances = np.zeros(_LINKTRACK_ANCHORS, dtype=np.float32)  # 0: no range
        distances[ranges.anchor] = ranges.range_m
        clock_ms = ranges.stamp_ns // 10**6 % 2**32
        # The module's own fix and IMU are off: quadlog does the fixing.
        own = {"pos_3d": 3, "eop_3d": 3, "vel_3d": 3, "angle_3d": 3, "quaternion": 4, "imu_gyro_3d": 3, "imu_acc_3d": 3}
        return self._make(
            LINKTRACK,
            header=self._header(ranges.stamp_ns, "map", sequence),
            role=_LINKTRACK_TAG_ROLE,
            id=ranges.tag,
            local_time=clock_ms,
            system_time=clock_ms,
            voltage=_LINKTRACK_VOLTAGE,
            dis_arr=distances,
            **{name: np.zeros(size, dtype=np.float32) for name, size in own.items()},
        )

    def _imu(self, imu: Imu, sequence: int) -> Any:
        assert imu.quat_xyzw is not None
        return self._make(
            TYPE_NAMES[Imu],
            header=self._header(imu.stamp_ns, imu.frame_id, sequence),
            orientation=self._quaternion(imu.quat_xyzw),
            orientation_covariance=np.zeros(9),
            angular_velocity=self._vector(imu.angular_radps),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector(imu.linear_mps2),
            linear_acceleration_covariance=np.zeros(9),
        )

    def _pose_fields(self, position_m: Float, quat_xyzw: Float) -> Any:
        return self._make(
            "geometry_msgs/msg/Pose",
            position=self._vector(position_m, "Point"),
            orientation=self._quaternion(quat_xyzw),
        )

    def _pose(self, pose: Pose, sequence: int) -> Any:
        return self._make(
            TYPE_NAMES[Pose],
            header=self._header(pose.stamp_ns, pose.frame_id, sequence),
            pose=self._pose_fields(pose.position_m, pose.quat_xyzw),
        )

    def _odometry(self, odometry: Odometry, sequence: int) -> Any:
        twist = self._make(
            "geometry_msgs/msg/Twist",
            linear=self._vector(odometry.linear_mps),
            angular=self._vector(odometry.angular_radps),
        )
        pose = self._pose_fields(odometry.position_m, odometry.quat_xyzw)
        return self._make(
            TYPE_NAMES[Odometry],
            header=self._header(odometry.stamp_ns, odometry.frame_id, sequence),
            child_frame_id=odometry.child_frame_id,
            pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def _transforms(self, transforms: Transforms, sequence: int) -> Any:
        stamped = [
            self._make(
                "geometry_msgs/msg/TransformStamped",
                header=self._header(pose.stamp_ns, pose.frame_id, sequence),
                child_frame_id=pose.child_frame_id,
                transform=self._make(
                    "geometry_msgs/msg/Transform",
                    translation=self._vector(pose.position_m),
                    rotation=self._quaternion(pose.quat_xyzw),
                ),
            )
            for pose in transforms.transforms
        ]
        return self._make(TYPE_NAMES[Transforms], transforms=stamped)
