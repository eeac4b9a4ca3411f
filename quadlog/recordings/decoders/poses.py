"""Poses, odometry, transforms, satellite fixes and IMU samples; positions and attitudes that are not finite or out of
reach are refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from quadlog.geometry import FARTHEST_M
from quadlog.messages import UNITS_M, Float, Imu, Odometry, Pose, Transforms, Twist
from quadlog.recordings.decoders.fields import Columns
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.rows import HEADER, NO_TURN, OWN_HEADER, Part, Type, part, unit_rows


def sound_position_m(columns: Columns) -> Float:
    """(N, 3) or (N, T, 3); messages with one that is not finite or out of reach are refused."""
    position_m: Float = columns["position"]
    columns.refuse(~(np.abs(position_m) <= FARTHEST_M), f"its position is not finite, or beyond {FARTHEST_M:.0e} m")
    return position_m


def _quat_xyzw(columns: Columns) -> Float:
    quat_xyzw, finite = unit_rows(columns["quat"])
    columns.refuse(~finite, "its quaternion is not finite")
    return quat_xyzw


def pose(columns: Columns, _: JointOrder, *, flag: str = "", lost_if: bool = False) -> Iterator[Part]:
    """A pose, with a twist an odometry. flag: field that is lost_if in messages whose pose was not measured."""
    if flag:
        columns.refuse(columns["lost"].astype(bool) == lost_if, f"the body is not tracked ({flag})")
    quat_xyzw = _quat_xyzw(columns) if "quat" in columns else NO_TURN
    values: dict[str, Any] = {"position_m": sound_position_m(columns), "quat_xyzw": quat_xyzw}
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
    """Poses of any message by the fields of x, y and z, in a unit, and of a quaternion's x, y, z, w if it has one.

    A field with a minus in front counts with the other sign.
    """
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")[: len(fields)]
    signs = [-1.0 if field.startswith("-") else 1.0 for field in fields]

    def rows(columns: Columns, order: JointOrder) -> Iterator[Part]:
        numbers = np.stack([columns[name] for name in names], axis=1) * signs
        columns["position"] = numbers[:, :3] / round(1 / UNITS_M[unit])
        if len(names) > 3:
            columns["quat"] = numbers[:, 3:]
        return pose(columns, order)

    wanted = {name: field.removeprefix("-") for name, field in zip(names, fields, strict=True)}
    return Type((Pose,), OWN_HEADER | wanted, rows)


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
    position_m, quat_xyzw, stamp_ns = sound_position_m(columns), _quat_xyzw(columns), columns.stamp_ns()
    for i in range(position_m.shape[1]):
        found = part(Transforms, columns.n, position_m=position_m[:, i], quat_xyzw=quat_xyzw[:, i], index=i)
        yield found._replace(stamp_ns=None if stamp_ns is None else stamp_ns[:, i], frames=columns.frames(i))


def pose_at(path: str, header: str = "header", position: str = "position", quat: str = "orientation") -> dict[str, str]:
    """The columns of a pose whose fields lie at a path, with those of a header."""
    stamped = {column: each.replace("header", header, 1) for column, each in HEADER.items()}
    return stamped | {"position": f"{path}.{position}:xyz", "quat": f"{path}.{quat}:xyzw"}


TRANSFORM = pose_at("transform", position="translation", quat="rotation") | {"child": "child_frame_id"}
TWIST = {"child": "child_frame_id", "linear": "twist.twist.linear:xyz", "angular": "twist.twist.angular:xyz"}


VELOCITY = {each: f"twist.{each}:xyz | twist.twist.{each}:xyz" for each in ("linear", "angular")}
COMMAND = {each: f"{each}:xyz" for each in ("linear", "angular")}


def _twist(columns: Columns) -> dict[str, Any]:
    columns.refuse(~np.isfinite(np.hstack([columns["linear"], columns["angular"]])), "its velocity is not finite")
    return {"linear_mps": columns["linear"], "angular_radps": columns["angular"]}


def command(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """A velocity that is wanted, in the body."""
    yield part(Twist, columns.n, **_twist(columns))


def velocity(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """A body's twist without a place, which is NaN: the header names the body's frame."""
    made = part(Odometry, columns.n, position_m=np.nan, quat_xyzw=NO_TURN, **_twist(columns))
    yield made._replace(frames=("", columns.frames()[0]))


def imu(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """Without orientation where its covariance begins with -1, or where it is all zeros, as drivers forget that."""
    absent = (columns["covariance"] == -1) | ~columns["quat"].any(axis=1)
    quat_xyzw, finite = unit_rows(columns["quat"])
    columns.refuse(~finite & ~absent, "its quaternion is not finite")
    quat_xyzw[absent] = np.nan
    rates = {"angular_radps": columns["rate"], "linear_mps2": columns["acceleration"]}
    yield part(Imu, columns.n, quat_xyzw=quat_xyzw, **rates)


IMU_FIELDS = {"quat": "orientation:xyzw", "covariance": "orientation_covariance[0]", "rate": "angular_velocity:xyz"}
IMU_FIELDS |= {"acceleration": "linear_acceleration:xyz"}
