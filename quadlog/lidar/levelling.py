"""Levelling: the tilt of the robot's body at the time of a scan, from IMU orientations, and of a lidar by its floor.

[Following] turns a point by roll and pitch before the heading. Only the direction that is up in the body matters for
that, and it is interpolated: it knows no heading, so an IMU whose north is anywhere serves as well.

Limitation: a small tilt of the IMU's mount that is missing in tf tilts every scan by as much.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import rotation_from_quat
from quadlog.lidar.paper_method import PaperSettings, fit_ground
from quadlog.messages import Float, Int

MAX_AGE_NS = 200_000_000
"""Longest time between a scan and an orientation used for it."""
MAX_TILT_RAD = math.radians(40.0)
"""A walking robot tilts less; more means an IMU mounted another way round, or a fall."""


class NotLevelled(StrEnum):
    """Why a scan is not levelled."""

    STALE = "no orientation within 0.2 s"
    STEEP = "tilted by more than 40 degrees"


class UpSeries(NamedTuple):
    """Which direction is up in base: up (N, 3) of unit length at t_ns (N,), strictly increasing."""

    t_ns: Int
    up: Float


def up_in_base(t_ns: Int, quat_xyzw: Float, rotation_sensor_to_base: Float | None = None) -> UpSeries:
    """What orientations (N, 4) of a sensor, in a world whose z is up, say at t_ns (N,), strictly increasing.

    rotation_sensor_to_base: (3, 3), None if mounted as base is. Rows that are no rotation (NaN, zero) are left out.
    """
    real = np.isfinite(quat_xyzw).all(axis=1) & (np.abs(quat_xyzw).max(axis=1, initial=0.0) > 1e-6)
    up = rotation_from_quat(quat_xyzw[real])[:, 2]
    return UpSeries(t_ns[real], up if rotation_sensor_to_base is None else up @ rotation_sensor_to_base.T)


def level_rotations(t_ns_wanted: Int, series: UpSeries) -> tuple[Float, NotLevelled | None]:
    """(W, 3, 3) rotations R_y(pitch) R_x(roll) that turn base upright at the instants (W,) of one scan. [Following]

    Where one of them is unknown, all are the identity and the reason is returned: half a levelled scan would be torn.
    """
    up, is_stale = _up_at(t_ns_wanted, series)
    unknown = NotLevelled.STALE if is_stale.any() else NotLevelled.STEEP if np.isnan(up).any() else None
    if unknown is not None:
        return np.tile(np.eye(3), (len(t_ns_wanted), 1, 1)), unknown
    x, y, z = up.T
    cos_pitch = np.hypot(y, z)
    sin_roll, cos_roll, none = y / cos_pitch, z / cos_pitch, np.zeros(len(up))
    rows = [[cos_pitch, -x * sin_roll, -x * cos_roll], [none, cos_roll, -sin_roll], [x, y, z]]
    return np.array(rows).transpose(2, 0, 1), None


def tilt_at(t_ns_wanted: Int, series: UpSeries) -> Float:
    """Roll and pitch (W, 2) of base at instants (W,); NaN where level_rotations would not level a scan."""
    return tilt_of(_up_at(t_ns_wanted, series)[0])


def _up_at(t_ns_wanted: Int, series: UpSeries) -> tuple[Float, NDArray[np.bool_]]:
    """Directions (W, 3), NaN where unknown, and (W,) whether that is for want of an orientation in time."""
    if len(series.t_ns) == 0:
        return np.full((len(t_ns_wanted), 3), np.nan), np.ones(len(t_ns_wanted), np.bool_)
    after = np.minimum(np.searchsorted(series.t_ns, t_ns_wanted, "left"), len(series.t_ns) - 1)
    before = np.maximum(np.searchsorted(series.t_ns, t_ns_wanted, "right") - 1, 0)
    since_ns, until_ns = np.abs(t_ns_wanted - series.t_ns[before]), np.abs(series.t_ns[after] - t_ns_wanted)
    share = (since_ns / np.maximum(since_ns + until_ns, 1))[:, None]
    up = (1 - share) * series.up[before] + share * series.up[after]
    # Opposite directions have no mean, and are steep.
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    is_stale = np.maximum(since_ns, until_ns) > MAX_AGE_NS
    up[is_stale | (up[:, 2] < math.cos(MAX_TILT_RAD))] = np.nan
    return up, is_stale


def tilt_of(up: Float) -> Float:
    """Roll and pitch (N, 2) of base in which the directions (N, 3) are up.

    They are the last row of its rotation: (-sin pitch, cos pitch sin roll, cos pitch cos roll).
    """
    x, y, z = up.T
    # Adding 0 turns the -0 of a level robot into 0.
    return np.column_stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))]) + 0.0


FLOOR = PaperSettings(min_range_m=0.3, max_range_m=5.0, ground_inlier_share=0.2)
FLOOR_BELOW_M, FLOOR_ABOVE_M = (0.1, 2.5), (0.1, 1.0)
"""Where the floor of a robot is looked for; above, for a lidar mounted upside down: no robot has a ceiling so near."""
_PLANES, _POINTS = 5, 4000


def up_by_floor(xyz_m: Float, rotation: Float) -> Float | None:
    """Which direction (3,) is up by the floor that a lidar sees among its points (N, 3); None where it sees none.

    rotation: (3, 3) that the points are turned by first. The floor is the largest plane near the lidar that a robot
    could stand on, above it where it is mounted upside down.
    """
    near = xyz_m[(np.abs(xyz_m) < FLOOR.max_range_m).all(axis=1)] @ rotation.T
    range_m = np.linalg.norm(near, axis=1)
    near = near[(range_m > FLOOR.min_range_m) & (range_m < FLOOR.max_range_m)]
    near = near[:: max(len(near) // _POINTS, 1)]
    for seed in range(_PLANES):
        if (found := fit_ground(near, FLOOR, seed)) is None:
            return None
        plane, on_plane = found
        low_m, high_m = FLOOR_BELOW_M if plane.d_m > 0 else FLOOR_ABOVE_M
        if plane.is_level and low_m < abs(plane.d_m) < high_m:
            return plane.normal * np.sign(plane.d_m)
        near = near[~on_plane]
    return None
