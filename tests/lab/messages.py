"""ROS messages of both worlds, made and written by rosbags: the oracle for what quadlog reads by hand."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ros_messages import BUNDLED, HEADER_FIELD

KINDS = ["ros1", "little", "big"]
CAMEL = {"motor_state": "motorState", "foot_force": "footForce", "tau_est": "tauEst", "yaw_speed": "yawSpeed"}
FIELD_TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
XYZ = np.dtype([(axis, "<f4") for axis in "xyz"])
LEVEL = (0.0, 0.0, 0.0, 1.0)
At = tuple[float, float, float]
"""x_m, y_m, yaw_rad."""


@cache
def store_of(kind: str) -> Any:
    """Standard and bundled types; LinkTrack's also in packages that drop or add a header, Unitree's as in ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    for path in BUNDLED.glob("*/msg/*.msg"):
        package, text, name = path.parent.parent.name, path.read_text(), path.stem
        texts = {package: text}
        if package == "nlink_parser":
            texts |= {"link_parser": text, "ros2_port": HEADER_FIELD * ("frame" in name) + text}
        if package == "ros2_unitree_legged_msgs":
            for word, camel in CAMEL.items():
                text = text.replace(word, camel)
            texts["unitree_legged_msgs"] = text
        for package, text in texts.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    if "tf2_msgs/msg/TFMessage" not in store.fielddefs:
        tf2 = "geometry_msgs/TransformStamped[] transforms\n"
        store.register(get_types_from_msg(tf2, "tf2_msgs/msg/TFMessage"))
    return store


@cache
def fields_of(kind: str, name: str) -> list[tuple[str, Nodetype, Any, str]]:
    """Name, kind and detail of each field; of an array of numbers their type."""
    found = []
    for field, (what, detail) in store_of(kind).fielddefs[name][1]:
        base = detail[0][1][0] if what in (Nodetype.ARRAY, Nodetype.SEQUENCE) and detail[0][0] == Nodetype.BASE else ""
        found.append((field, what, detail, base.replace("string", "")))
    return found


def zeroed(kind: str, name: str, /, **values: Any) -> Any:
    """A message whose fields are zero or empty, but for these; __ leads into an inner one; arrays may be lists."""
    within: dict[str, dict[str, Any]] = {}
    for path in [path for path in values if "__" in path]:
        field, _, rest = path.partition("__")
        within.setdefault(field, {})[rest] = values.pop(path)

    def zero(what: Nodetype, detail: Any, inner: dict[str, Any]) -> Any:
        if what == Nodetype.BASE:
            return "" if detail[0] == "string" else 0.0 if detail[0].startswith("float") else 0
        if what == Nodetype.NAME:
            return zeroed(kind, detail, **inner)
        (of, detail), count = detail[0], detail[1] if what == Nodetype.ARRAY else 0
        return [zero(of, detail, {}) for _ in range(count)]

    made = []
    for field, what, detail, dtype in fields_of(kind, name):
        if field not in values and dtype:
            made.append(np.zeros(detail[1] if what == Nodetype.ARRAY else 0, dtype))
        elif field not in values:
            made.append(zero(what, detail, within.pop(field, {})))
        else:
            made.append(np.array(values.pop(field), dtype) if dtype else values.pop(field))
    assert not values | within, name
    return store_of(kind).types[name](*made)


def serialised(kind: str, message: Any, store: Any = None) -> bytes:
    store, name = store or store_of(kind), message.__msgtype__
    if kind == "ros1":
        return bytes(store.serialize_ros1(message, name))
    return bytes(store.serialize_cdr(message, name, little_endian=kind != "big"))


def channel_of(kind: str, name: str, topic: str = "/uwb/n_3", *, embedded: bool = True, store: Any = None) -> Channel:
    encoding, version = ("ros1", 1) if kind == "ros1" else ("cdr", 2)
    text = (store or store_of(kind)).generate_msgdef(name, ros_version=version)[0] if embedded else ""
    return Channel(topic, name, encoding, f"ros{version}msg" if embedded else "", text.encode())


def yawed(yaw_rad: float) -> tuple[float, ...]:
    """x, y, z, w."""
    return 0.0, 0.0, float(np.sin(yaw_rad / 2)), float(np.cos(yaw_rad / 2))


class Ros:
    """Messages of one kind."""

    def __init__(self, kind: str = "little") -> None:
        self.kind, self.store = kind, store_of(kind)
        self.encoding = "ros1" if kind == "ros1" else "cdr"

    def make(self, name: str, /, **values: Any) -> Any:
        return zeroed(self.kind, name, **values)

    def register(self, **texts: str) -> None:
        """Types of `own/msg` by their definitions."""
        for name, text in texts.items():
            self.store.register(get_types_from_msg(text, f"own/msg/{name}"))

    def serialise(self, message: Any) -> bytes:
        return serialised(self.kind, message)

    def channel(self, topic: str, name: str, *, embedded: bool = True) -> Channel:
        return channel_of(self.kind, name, topic, embedded=embedded)

    def stamp(self, t_ns: int) -> Any:
        return self.make("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)

    def header(self, t_ns: int, frame: str = "lidar") -> Any:
        return self.make("std_msgs/msg/Header", stamp=self.stamp(int(t_ns)), frame_id=frame)

    def vector(self, *xyz: float, name: str = "Vector3") -> Any:
        """Also a Point, or a Quaternion."""
        return self.store.types[f"geometry_msgs/msg/{name}"](*map(float, xyz))

    def pose(self, xyz: tuple[float, ...], xyzw: tuple[float, ...] = LEVEL) -> Any:
        ends = {"position": self.vector(*xyz, name="Point"), "orientation": self.vector(*xyzw, name="Quaternion")}
        return self.make("geometry_msgs/msg/Pose", **ends)

    def odometry(
        self, t_ns: int, at: At = (0, 0, 0), frame: str = "odom", child: str = "base_link", twist: Any = (0,) * 6
    ) -> Any:
        """twist: velocity and angular velocity of the child."""
        moving = {"twist__twist__linear": self.vector(*twist[:3]), "twist__twist__angular": self.vector(*twist[3:])}
        where = {"header": self.header(t_ns, frame), "child_frame_id": child}
        pose = self.pose((*at[:2], 0), yawed(at[2]))
        return self.make("nav_msgs/msg/Odometry", **where, pose__pose=pose, **moving)

    def range(self, t_ns: int, range_m: float, limits_m: tuple[float, float] = (0.0, 0.0)) -> Any:
        values = {"range": range_m, "min_range": limits_m[0], "max_range": limits_m[1]}
        return self.make("sensor_msgs/msg/Range", header=self.header(t_ns, ""), **values)

    def transform(self, t_ns: int, parent: str, child: str, xyz: Any, xyzw: Any = LEVEL) -> Any:
        ends = {"translation": self.vector(*xyz), "rotation": self.vector(*xyzw, name="Quaternion")}
        inner = self.make("geometry_msgs/msg/Transform", **ends)
        where = {"header": self.header(t_ns, parent), "child_frame_id": child}
        return self.make("geometry_msgs/msg/TransformStamped", **where, transform=inner)

    def tf(self, *transforms: Any) -> Any:
        return self.make("tf2_msgs/msg/TFMessage", transforms=list(transforms))

    def cloud(
        self, t_ns: int, points: np.ndarray, frame: str = "lidar", *, rows: int = 1, padding: int = 0, **said: Any
    ) -> Any:
        """A PointCloud2 of a structured array, or of coordinates (N, 3), with `padding` bytes after each row.

        said: fields of the message, whatever is in it.
        """
        if points.dtype.names is None:
            points = np.ascontiguousarray(points, "<f4").view(XYZ).ravel()
        fields, step, width = [], points.dtype.itemsize, len(points) // rows
        for name, (dtype, offset, *_) in points.dtype.fields.items():
            base, shape = dtype.subdtype or (dtype, ())
            values = {"offset": offset, "datatype": FIELD_TYPES[base.str[1:]], "count": int(np.prod(shape, dtype=int))}
            fields.append(self.make("sensor_msgs/msg/PointField", name=name, **values))
        table = np.zeros((rows, width * step + padding), np.uint8)
        table[:, : width * step] = points.view(np.uint8).reshape(rows, width * step)
        size = {"height": rows, "width": width, "point_step": step, "row_step": table.shape[1], "is_dense": True}
        made = {"header": self.header(t_ns, frame), "fields": fields, "data": table.reshape(-1)} | size | said
        return self.make("sensor_msgs/msg/PointCloud2", **made)
