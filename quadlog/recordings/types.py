"""The table of message types: the fields that are wanted of each, and what these become. A sensor is a row here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import FARTHEST_M
from quadlog.messages import (
    NO_ID,
    ROWS,
    TICKS,
    UNITS_M,
    UNPLACED,
    Float,
    Imu,
    Int,
    JointStates,
    Message,
    Odometry,
    PointCloud,
    Pose,
    Transforms,
    UwbRanges,
)
from quadlog.positioning.two_way_ranging import general_range_m
from quadlog.recordings.decoders.fields import Columns
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.laser_scan import LASER_SCAN, MULTI_ECHO, laser_scan


class Part(NamedTuple):
    """Rows (R,) of one kind, of some messages.

    of: (R,) which message each row is of, None: row i of message i. stamp_ns: (N,) of the messages, frames: of all of
    them; None: as their headers have it. unmeasured: as in Batch.
    """

    kind: type[Message]
    rows: NDArray[np.void]
    of: Int | None = None
    stamp_ns: Int | None = None
    frames: tuple[str, str] | None = None
    unmeasured: str = ""


class Type(NamedTuple):
    """kinds: what a message becomes, the main one first; wanted: column -> path; rows: from columns to parts.

    rows raises DecodeError, or what a definition of another shape makes numpy raise.
    """

    kinds: tuple[type[Message], ...]
    wanted: Mapping[str, str]
    rows: Callable[[Columns, JointOrder], Iterator[Part]]


HEADER = {"sec": "header.stamp.sec ?", "nanosec": "header.stamp.nanosec ?", "frame": "header.frame_id ?"}


def part(kind: type[Message], n: int, *, of: Int | None = None, unmeasured: str = "", **values: Any) -> Part:
    """A part of n rows with these values."""
    rows = np.zeros(n, UNPLACED if kind is UwbRanges and "anchor_position_m" not in values else ROWS[kind])
    for name, value in values.items():
        rows[name] = value
    return Part(kind, rows, of, unmeasured=unmeasured)


NO_TURN = (0.0, 0.0, 0.0, 1.0)


def unit_rows(quat_xyzw: Float) -> tuple[Float, np.ndarray]:
    """Quaternions (..., 4) at unit length, all zeros as no rotation; and (...,) which are finite."""
    x, y, z, w = np.moveaxis(quat_xyzw, -1, 0)
    length = np.sqrt(x * x + y * y + z * z + w * w)
    unit = quat_xyzw / length[..., None]
    unit[length == 0] = NO_TURN
    return unit, np.isfinite(length)


def reachable(position_m: Float) -> np.ndarray:
    """Which numbers of positions are finite and no farther out than FARTHEST_M."""
    return np.abs(position_m) <= FARTHEST_M


def is_static(topic: str) -> bool:
    """Whether a topic of transforms carries static ones, by its name, as tf2 has it."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


def _position_m(columns: Columns) -> Float:
    position_m: Float = columns["position"]
    columns.refuse(~reachable(position_m), f"its position is not finite, or beyond {FARTHEST_M:.0e} m")
    return position_m


def _quat_xyzw(columns: Columns) -> Float:
    quat_xyzw, finite = unit_rows(columns["quat"])
    columns.refuse(~finite, "its quaternion is not finite")
    return quat_xyzw


def pose(columns: Columns, _: JointOrder, *, flag: str = "", lost_if: bool = False) -> Iterator[Part]:
    """A pose, with a twist an odometry. flag: field that is lost_if in messages whose pose was not measured."""
    if flag:
        columns.refuse(columns["lost"].astype(bool) == lost_if, f"the body is not tracked ({flag})")
    values = {"position_m": _position_m(columns), "quat_xyzw": _quat_xyzw(columns) if "quat" in columns else NO_TURN}
    if "linear" in columns:
        twist = {"linear_mps": columns["linear"], "angular_radps": columns["angular"]}
        yield part(Odometry, columns.n, **values, **twist)
    else:
        yield part(Pose, columns.n, **values)


def flat_pose(columns: Columns, order: JointOrder) -> Iterator[Part]:
    """x, y and the angle about z."""
    zero, half_rad = np.zeros(columns.n), columns["theta"] / 2
    columns["position"] = np.stack([columns["x"], columns["y"], zero], axis=1)
    columns["quat"] = np.stack([zero, zero, np.sin(half_rad), np.cos(half_rad)], axis=1)
    return pose(columns, order)


def own_pose(fields: Sequence[str], unit: str = "m") -> Type:
    """Poses of any message: the fields of x, y and z in a unit and, where it has these, of the quaternion x, y, z, w."""
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")[: len(fields)]

    def rows(columns: Columns, order: JointOrder) -> Iterator[Part]:
        numbers = np.stack([columns[name] for name in names], axis=1)
        columns["position"] = numbers[:, :3] / round(1 / UNITS_M[unit])
        if len(names) > 3:
            columns["quat"] = numbers[:, 3:]
        return pose(columns, order)

    return Type((Pose,), HEADER | dict(zip(names, fields, strict=True)), rows)


_AXIS_M, _E2 = 6378137.0, 6.69437999014e-3  # of the ellipsoid of WGS 84


def fix(columns: Columns, order: JointOrder) -> Iterator[Part]:
    """Satellite fixes in metres east, north and up of the channel's first; messages without a fix are refused."""
    latitude, longitude = np.radians(columns["latitude"]), np.radians(columns["longitude"])
    none = (columns["status"] < 0) | ~(np.abs(latitude) <= np.pi / 2) | ~(np.abs(longitude) <= 2 * np.pi)
    columns.refuse(none, "it has no fix")
    up = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=1
    )
    normal_m = _AXIS_M / np.sqrt(1 - _E2 * up[:, 2] ** 2)
    earth_m = up * (normal_m + np.nan_to_num(columns["altitude"]))[:, None]
    earth_m[:, 2] -= _E2 * normal_m * up[:, 2]
    if columns.sound.any():
        at = int(np.argmax(columns.sound))
        east = np.array([-np.sin(longitude[at]), np.cos(longitude[at]), 0.0])
        axes = np.array([east, np.cross(up[at], east), up[at]])
        first_m, axes = columns.memory.setdefault("first", (earth_m[at], axes))
        columns["position"] = (earth_m - first_m) @ axes.T
        yield from (each._replace(frames=(EAST_NORTH_UP, "")) for each in pose(columns, order))


FIX = {"status": "status.status", **{name: name for name in ("latitude", "longitude", "altitude")}}
EAST_NORTH_UP = "east_north_up"
"""Frame of positions from satellites, whose messages name the receiver's antenna instead."""


def transforms(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """A part for each place in the message: names differ, as do stamps."""
    position_m, quat_xyzw, stamp_ns = _position_m(columns), _quat_xyzw(columns), columns.stamp_ns()
    for i in range(position_m.shape[1]):
        found = part(Transforms, columns.n, position_m=position_m[:, i], quat_xyzw=quat_xyzw[:, i], index=i)
        yield found._replace(stamp_ns=None if stamp_ns is None else stamp_ns[:, i], frames=columns.frames(i))


def pose_at(path: str, header: str = "header", position: str = "position", quat: str = "orientation") -> dict[str, str]:
    """The columns of a pose whose fields lie at a path, with those of a header."""
    stamped = {column: each.replace("header", header, 1) for column, each in HEADER.items()}
    return stamped | {"position": f"{path}.{position}:xyz", "quat": f"{path}.{quat}:xyzw"}


TRANSFORM = pose_at("transform", position="translation", quat="rotation") | {"child": "child_frame_id"}
TWIST = {"child": "child_frame_id", "linear": "twist.twist.linear:xyz", "angular": "twist.twist.angular:xyz"}


def imu(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """Without orientation where its covariance begins with -1, or where it is all zeros, as drivers forget that."""
    absent = (columns["covariance"][:, 0] == -1) | ~columns["quat"].any(axis=1)
    quat_xyzw, finite = unit_rows(columns["quat"])
    columns.refuse(~finite & ~absent, "its quaternion is not finite")
    quat_xyzw[absent] = np.nan
    rates = {"angular_radps": columns["rate"], "linear_mps2": columns["acceleration"]}
    yield part(Imu, columns.n, quat_xyzw=quat_xyzw, **rates)


IMU_FIELDS = {"quat": "orientation:xyzw", "covariance": "orientation_covariance[1]", "rate": "angular_velocity:xyz"}
IMU_FIELDS |= {"acceleration": "linear_acceleration:xyz"}


def joint_state(columns: Columns, order: JointOrder) -> Iterator[Part]:
    """Raises DecodeError for lists of different lengths, UnknownJoints without legs."""
    names, lists = (
        columns["names"],
        {"positions": "position_rad", "velocities": "velocity_radps", "efforts": "torque_nm"},
    )
    for what, name in lists.items():
        if columns[name].shape[1] not in (0, len(names)):
            raise ValueError(f"names {len(names)} joints, but has {columns[name].shape[1]} {what}")
    found = order.of_names(names, columns.topic)
    values = {
        name: columns[name][:, found.place] * found.sign if columns[name].shape[1] else np.nan
        for name in lists.values()
    }
    forces = found.feet is not None and columns["torque_nm"].shape[1]
    feet = columns["torque_nm"][:, found.feet] if forces else np.nan
    yield part(JointStates, columns.n, **values, foot_force_n=feet, tick=np.nan)


JOINT_STATE = {"names": "name[]", "position_rad": "position[]", "velocity_radps": "velocity[]", "torque_nm": "effort[]"}

# States of Unitree's robots, ROS 1 and 2, fields as in unitree_go and unitree_legged_msgs. Quaternions are w, x, y, z.


def unitree(columns: Columns, order: JointOrder) -> Iterator[Part]:
    """Odometry, joints with feet, and IMU, as far as a message has them."""
    quat_xyzw, finite = unit_rows(columns["wxyz"][:, [1, 2, 3, 0]])
    absent = ~finite | ~columns["wxyz"].any(axis=1)
    if "position" in columns:
        linear_mps = columns["velocity"] * (1.0, 1.0, 0.0) if "velocity" in columns else 0.0
        yield part(
            Odometry,
            columns.n,
            position_m=_position_m(columns),
            quat_xyzw=np.where(absent[:, None], NO_TURN, quat_xyzw),
            linear_mps=linear_mps,
            angular_radps=np.column_stack([columns["rate"][:, :2], columns["yaw_rate"]]),
        )._replace(frames=("odom", ""))
    if "q" in columns:
        feet, tick = columns["feet"], columns["tick"] % TICKS if "tick" in columns else np.nan
        found = order.of_motors(columns["q"].shape[1], feet.shape[1], columns.topic)
        names = {"position_rad": "q", "velocity_radps": "dq", "torque_nm": "tau"}
        values = {name: columns[column][:, found.place] * found.sign for name, column in names.items()}
        yield part(JointStates, columns.n, **values, foot_force_n=feet[:, found.feet], tick=tick)
    quat_xyzw[absent] = np.nan
    rates = {"angular_radps": columns["rate"], "linear_mps2": columns["acceleration"]}
    yield part(Imu, columns.n, quat_xyzw=quat_xyzw, **rates)


_STATE = {
    column: f"imu_state.{name} | imu.{name}"
    for column, name in (("wxyz", "quaternion[4]"), ("rate", "gyroscope[3]"), ("acceleration", "accelerometer[3]"))
}
_WAY = {"position": "position[3]", "yaw_rate": "yaw_speed | yawSpeed"}
_MOTORS = {
    "q": "motor_state[].q | motorState[].q ?",
    "dq": "motor_state[].dq | motorState[].dq ?",
    "tau": "motor_state[].tau_est | motorState[].tauEst ?",
    "feet": "foot_force[] | footForce[] ?",
    "tick": "tick ?",
}
# Since unitree_legged_sdk 3.8 with motors. No document says in which axes the velocity of SportModeState is.
LOW_STATE = Type((JointStates, Imu), HEADER | _STATE | _MOTORS, unitree)
HIGH_STATE = Type((Odometry, JointStates, Imu), HEADER | _STATE | _WAY | {"velocity": "velocity[3]"} | _MOTORS, unitree)
SPORT_MODE = {"sec": "stamp.sec", "nanosec": "stamp.nanosec"} | _STATE | _WAY

# Ranges: distances (N,) or (N, T); ids and signal strengths in the same arrays or in those around them.


def ranges(
    columns: Columns,
    _: JointOrder,
    *,
    unit: str = "m",
    zero_is_none: bool = False,
    ids: Mapping[str, int] = {},
    unmeasured: Callable[[Columns], Mapping[str, np.ndarray]] = lambda _: {},
) -> Iterator[Part]:
    """Tags and anchors by ids or columns; without either, an anchor is the place in its array, or unknown.

    unmeasured: why -> (N,) or (N, T) which ranges were not measured, as their messages say.
    """
    distance = columns["range"].reshape(columns.n, -1)
    values: dict[str, Any] = {"tag": NO_ID, "anchor": columns.places("range") if columns.arrays["range"] else NO_ID}
    values |= {name: columns.beside(name, "range") for name in values if name in columns} | dict(ids)
    values["range_m"] = distance / round(1 / UNITS_M[unit])
    there = distance != 0 if zero_is_none else np.ones(distance.shape, dtype=bool)
    for why, mask in unmeasured(columns).items():
        absent = there & mask.reshape(columns.n, -1)
        if absent.any():
            yield _measured(absent, why, **values)
            there &= ~absent
    if "place" in columns:
        values["anchor_position_m"] = columns["place"][:, None]
    yield _measured(there, **values)


def _measured(there: np.ndarray, unmeasured: str = "", **values: Any) -> Part:
    """Ranges with these values where they are there (N, T)."""
    of, at = np.nonzero(there)
    for name, value in values.items():
        value = np.asarray(value)
        values[name] = np.broadcast_to(value, there.shape + value.shape[2:])[of, at]
    return part(UwbRanges, len(of), of=of, unmeasured=unmeasured, **{"first_path_gap_db": np.nan} | values)


def node_ranges(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """A tag's frame lists its anchors, an anchor's frame lists tags; plain nodes have no roles and count as tags."""
    other, other_role, range_m = columns["other"], columns["other_role"], columns["range"]
    of_anchor = columns["role"][:, None] == ROLE_ANCHOR
    there = (range_m != 0) & (other_role != np.where(of_anchor, ROLE_ANCHOR, ROLE_TAG))
    own = columns.beside("id", "range")
    tag, anchor = np.where(of_anchor, other, own), np.where(of_anchor, own, other)
    yield _measured(there, tag=tag, anchor=anchor, range_m=range_m, first_path_gap_db=columns["rx"] - columns["fp"])


def _outside_limits(columns: Columns) -> dict[str, np.ndarray]:
    """Of a sensor_msgs/Range; drivers may leave both limits at zero."""
    range_m, low_m, high_m = (columns[name] for name in ("range", "low", "high"))
    outside = (low_m >= 0) & (low_m < high_m) & ((range_m < low_m) | (range_m > high_m))
    return _infinite(columns) | {"they are outside min_range to max_range of their own messages": outside}


def _failed(columns: Columns) -> dict[str, np.ndarray]:
    """Of a uwb_driver/UwbRange: values of range_status, and bits of the even ones; others are remarks on a range."""
    status = columns.get("status", np.zeros(columns.n, np.int64))
    failed = np.isin(status, (1, 3)) | ((status % 2 == 0) & (status & 0b100110 != 0))
    return {"their range_status says that the ranging failed": failed}


def _no_error(columns: Columns) -> dict[str, np.ndarray]:
    """Of a gtec_msgs/Ranging; its errorEstimation is a standard deviation."""
    error = columns.get("error", np.zeros(columns.n))
    return {"their errorEstimation is negative or not finite": ~((error >= 0) & (error < np.inf))}


ROLE_ANCHOR, ROLE_TAG = 1, 2
_NODE = {"id": "id", "role": "role", "other": "nodes[].id", "other_role": "nodes[].role", "range": "nodes[].dis"}
NODES = Type((UwbRanges,), HEADER | _NODE | {"rx": "nodes[].rx_rssi", "fp": "nodes[].fp_rssi"}, node_ranges)
_UWB_DRIVER = {"tag": "requester_id ?", "anchor": "responder_id", "range": "distance", "status": "range_status ?"}
_UWB_DRIVER |= {"place": "responder_location:xyz ?"}


def _type_of_ranges(unmeasured: Any = lambda _: {}, **fields: Any) -> Type:
    """fields: columns by their paths, and what `ranges` takes."""
    wanted = {name: fields.pop(name) for name in list(fields) if name not in ("unit", "zero_is_none", "ids")}
    return Type((UwbRanges,), HEADER | wanted, partial(ranges, unmeasured=unmeasured, **fields))


TWO_WAY = ("poll_tx", "poll_rx", "response_tx", "response_rx", "final_tx", "final_rx")
INTERVALS = ("round_a", "reply_a", "round_b", "reply_b")
WRAP = 1 << 40  # of the counters of DW1000 and DW3000; others have 32 bits


def own_ranges(
    *,
    field: str = "",
    unit: str = "m",
    tag: int | str | None = None,
    anchor: int | str | None = None,
    times: Sequence[str] = (),
    tick_s: float = 1.0,
) -> Type:
    """Ranges of any message. tag, anchor: an id, or its field; None: see `ranges`.

    times: instead of field, the fields of TWO_WAY, or of INTERVALS as quadlog.positioning.two_way_ranging has them, in
    ticks of tick_s.
    """
    ends = {"tag": tag, "anchor": anchor}
    wanted = {name: path for name, path in ends.items() if isinstance(path, str)}
    names = INTERVALS if len(times) == len(INTERVALS) else TWO_WAY
    wanted |= dict(zip(names, times, strict=True)) if times else {"range": field}

    def rows(columns: Columns, order: JointOrder) -> Iterator[Part]:
        if times:
            given = [columns[name].astype(np.float64) for name in names]
            columns.arrays |= {"range": columns.arrays[names[0]]}
            columns["range"] = general_range_m(tick_s * np.array(_intervals(*given) if len(given) > 4 else given))
        ids = {name: each for name, each in ends.items() if isinstance(each, int)}
        return ranges(columns, order, unit="m" if times else unit, ids=ids, unmeasured=_infinite)

    return Type((UwbRanges,), HEADER | wanted, rows)


def _intervals(*times: Float) -> list[Float]:
    """INTERVALS of TWO_WAY, in ticks; a negative one has begun before the counter began again."""
    poll_tx, poll_rx, response_tx, response_rx, final_tx, final_rx = times
    apart = [response_rx - poll_tx, final_tx - response_rx, final_rx - response_tx, response_tx - poll_rx]
    wrap = np.where(np.max(times, axis=0) < 1 << 32, 1 << 32, WRAP)
    return [np.where(each < 0, each + wrap, each) for each in apart]


def _infinite(columns: Columns) -> dict[str, np.ndarray]:
    return {"they are infinite: too near or too far [REP 117]": np.isinf(columns["range"])}


TYPES: dict[str, Type] = {
    "geometry_msgs/msg/PointStamped": Type((Pose,), HEADER | {"position": "point:xyz"}, pose),
    "geometry_msgs/msg/Pose2D": Type((Pose,), {"x": "x", "y": "y", "theta": "theta"}, flat_pose),
    "geometry_msgs/msg/PoseStamped": Type((Pose,), pose_at("pose"), pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": Type((Pose,), pose_at("pose.pose"), pose),
    "geometry_msgs/msg/TransformStamped": Type((Pose,), TRANSFORM, pose),
    "gtec_msgs/msg/Ranging": _type_of_ranges(
        _no_error, unit="mm", tag="tagId", anchor="anchorId", range="range", error="errorEstimation ?"
    ),
    "nav_msgs/msg/Odometry": Type((Odometry,), pose_at("pose.pose") | TWIST, pose),
    "sensor_msgs/msg/Imu": Type((Imu,), HEADER | IMU_FIELDS, imu),
    "sensor_msgs/msg/JointState": Type((JointStates,), HEADER | JOINT_STATE, joint_state),
    "sensor_msgs/msg/NavSatFix": Type((Pose,), HEADER | FIX, fix),
    "sensor_msgs/msg/Range": _type_of_ranges(_outside_limits, range="range", low="min_range", high="max_range"),
    "tf2_msgs/msg/TFMessage": Type(
        (Transforms,), {column: f"transforms[].{path}" for column, path in TRANSFORM.items()}, transforms
    ),
    "unitree_go/msg/LowState": LOW_STATE,
    "unitree_go/msg/SportModeState": Type((Odometry, Imu), SPORT_MODE, unitree),
    "unitree_legged_msgs/msg/HighState": HIGH_STATE,
    "unitree_legged_msgs/msg/LowState": LOW_STATE,
    "ros2_unitree_legged_msgs/msg/HighState": HIGH_STATE,
    "ros2_unitree_legged_msgs/msg/LowState": LOW_STATE,
    "uwb_driver/msg/UwbRange": _type_of_ranges(_failed, **_UWB_DRIVER),
    # LinkTrack packages have many names: matched by the last part of the type.
    "LinktrackAnchorframe0": _type_of_ranges(zero_is_none=True, tag="nodes[].id", range="nodes[].dis_arr[]"),
    "LinktrackNodeframe2": NODES,
    "LinktrackNodeframe3": NODES,
    "LinktrackNodeframe4": _type_of_ranges(
        zero_is_none=True, tag="tags[].id", anchor="tags[].anchors[].id", range="tags[].anchors[].dis"
    ),
    "LinktrackNodeframe5": NODES,
    "LinktrackTagframe0": _type_of_ranges(zero_is_none=True, tag="id", range="dis_arr[]"),
}
PLANAR_SCANS: dict[str, tuple[Mapping[str, str], Callable[[Columns], PointCloud]]] = {
    "sensor_msgs/msg/LaserScan": (HEADER | LASER_SCAN, laser_scan),
    "sensor_msgs/msg/MultiEchoLaserScan": (HEADER | MULTI_ECHO, laser_scan),
}
# Bodies too large for columns: read by hand. Each Livox driver has its package, and others copy its message: matched by
# the last part of the type, outside of Livox's packages by the definition, too.
POINT_CLOUD, LIVOX, LIVOX_PACKAGES = "sensor_msgs/msg/PointCloud2", "CustomMsg", "livox_"
FOXGLOVE: dict[str, type[Message]] = {"foxglove.PointCloud": PointCloud, "foxglove.PoseInFrame": Pose}
# Types that look as if they held what quadlog wants, and why they do not.
REFUSED = {
    "LinktrackNodeframe0": "carries raw bytes of other nodes, no ranges",
    "LinktrackNodeframe1": "carries solved positions, no ranges",
    "LinktrackNodeframe6": "carries raw bytes of other nodes, no ranges",
}


def last_part(type_name: str) -> str:
    """`LinktrackTagframe0` of `any_package/msg/LinktrackTagframe0`."""
    return type_name.rpartition("/")[2]


def type_of(type_name: str) -> Type | None:
    """The row of a type that is read as columns, None for all others."""
    return TYPES.get(type_name) or TYPES.get(last_part(type_name))
