"""Rigid transforms on plain arrays: 4x4 matrices named transform_A_to_B, quaternions as xyzw, yaw about z; poses
between poses.
"""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float, Int

FARTHEST_M = 1e8
"""The largest coordinate of a position; one beyond it, or one that is not finite, is damage and refused as input.

Earth-centred coordinates reach 6.4e6 m, UTM 1e7 m and Web Mercator 2e7 m.
"""


def transform_from_rpy(translation_m: Float, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Float:
    """(4, 4) transform that rotates by R_z(yaw) R_y(pitch) R_x(roll) and then translates by (3,) metres."""
    cr, cp, cy = np.cos([roll_rad, pitch_rad, yaw_rad])
    sr, sp, sy = np.sin([roll_rad, pitch_rad, yaw_rad])
    transform = np.eye(4)
    transform[0, :3] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    transform[1, :3] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    transform[2, :3] = -sp, cp * sr, cp * cr
    transform[:3, 3] = translation_m
    return transform


def transform_from_quat(position_m: Float, quat_xyzw: Float) -> Float:
    """(4, 4) transform of a pose: position (3,) in metres, quaternion (4,) as x, y, z, w."""
    transform = np.eye(4)
    transform[:3, :3] = rotation_from_quat(quat_xyzw)
    transform[:3, 3] = position_m
    return transform


def rotation_from_quat(quat_xyzw: Float) -> Float:
    """(..., 3, 3) rotations of quaternions (..., 4) as x, y, z, w, of any length but zero.

    scipy's, without its half a second of imports before the first scan.
    """
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    x, y, z, w = np.moveaxis(quat / np.linalg.norm(quat, axis=-1, keepdims=True), -1, 0)
    rows = [
        [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), y * y - x * x - z * z + w * w, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), z * z - x * x - y * y + w * w],
    ]
    rotations: Float = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    return rotations


def invert_transform(transform: Float) -> Float:
    """The inverse of a rigid (4, 4) transform."""
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


def apply_transform(transform: Float, points_m: Float) -> Float:
    """Points (N, 3) moved by a (4, 4) transform."""
    return points_m @ transform[:3, :3].T + transform[:3, 3]


def yaw_from_quat(quat_xyzw: Float) -> Float:
    """Yaw about z in (-pi, pi] of quaternions (..., 4) as x, y, z, w."""
    x, y, z, w = np.moveaxis(np.asarray(quat_xyzw, dtype=np.float64), -1, 0)
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def roll_pitch_from_quat(quat_xyzw: Float) -> Float:
    """Roll and pitch (..., 2) of quaternions (..., 4) as x, y, z, w of R_z(yaw) R_y(pitch) R_x(roll)."""
    x, y, z, w = np.moveaxis(np.asarray(quat_xyzw, dtype=np.float64), -1, 0)
    roll_rad = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    # Rounding may bring the sine of a right angle beyond 1.
    return np.stack([roll_rad, np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))], axis=-1)


def quat_from_euler(yaw_rad: Float, pitch_rad: Float | float = 0.0, roll_rad: Float | float = 0.0) -> Float:
    """Quaternions (..., 4) as x, y, z, w of R_z(yaw) R_y(pitch) R_x(roll), angles (...)."""
    halves = np.broadcast_arrays(*(np.asarray(each, float) / 2 for each in (yaw_rad, pitch_rad, roll_rad)))
    (cz, sz), (cy, sy), (cx, sx) = ((np.cos(half), np.sin(half)) for half in halves)
    quat = [
        cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx,
        cz * cy * cx + sz * sy * sx,
    ]
    # Adding 0 turns the -0 of a level walker into 0.
    return np.stack(quat, axis=-1) + 0.0


def poses_in_space(
    x_m: Float, y_m: Float, yaw_rad: Float, z_m: Float | None = None, tilt_rad: Float | None = None
) -> tuple[Float, Float]:
    """Positions (N, 3) and quaternions (N, 4) of poses whose height (N,) and roll and pitch (N, 2) may be unknown.

    Where these are NaN or None, the pose lies in the plane z = 0 and is level.
    """
    height_m = np.zeros(len(x_m)) if z_m is None else np.nan_to_num(z_m, nan=0.0)
    roll_rad, pitch_rad = np.zeros((2, len(x_m))) if tilt_rad is None else np.nan_to_num(tilt_rad, nan=0.0).T
    return np.column_stack([x_m, y_m, height_m]), quat_from_euler(np.asarray(yaw_rad, float), pitch_rad, roll_rad)


def wrap_angle(angle_rad: Float | float) -> Float:
    """The same angle in [-pi, pi)."""
    wrapped: Float = (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi
    return wrapped


def interpolate_angle(t_ns: Int, known_t_ns: Int, known_rad: Float) -> Float:
    """Angles at t_ns between known ones, along the shorter way round; held constant outside."""
    start_ns = int(known_t_ns[0])
    known_s, wanted_s = seconds_since(known_t_ns, start_ns), seconds_since(t_ns, start_ns)
    return wrap_angle(np.interp(wanted_s, known_s, np.unwrap(known_rad)))


def seconds_since(t_ns: Int, start_ns: int) -> Float:
    """Nanoseconds as float seconds since start_ns, subtracted before the conversion so that no digit is lost."""
    seconds: Float = (np.asarray(t_ns, dtype=np.int64) - np.int64(start_ns)) * 1e-9
    return seconds


def interpolate_poses(
    t_ns_wanted: Int, t_ns: Int, xy_m: Float, yaw_rad: Float, max_gap_s: float
) -> tuple[Float, Float, np.ndarray]:
    """Position (W, 2), yaw (W,) and validity (W,) bool at t_ns_wanted (W,), from poses at t_ns (N,) increasing.

    Linear between the two neighbours, yaw along the shorter way round. Valid
    where both lie within max_gap_s; before the first and after the last pose
    that pose is held for max_gap_s. What is not valid is NaN.
    """
    if len(t_ns) == 0:
        nowhere = np.full((len(t_ns_wanted), 3), np.nan)
        return nowhere[:, :2], nowhere[:, 2], np.zeros(len(t_ns_wanted), dtype=np.bool_)
    before = np.maximum(np.searchsorted(t_ns, t_ns_wanted, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(t_ns, t_ns_wanted, side="left"), len(t_ns) - 1)
    since_ns, until_ns = t_ns_wanted - t_ns[before], t_ns[after] - t_ns_wanted
    valid = np.maximum(np.abs(since_ns), np.abs(until_ns)) <= max_gap_s * 1e9
    between_ns = t_ns[after] - t_ns[before]
    # Where both neighbours are one pose, it is held.
    share = np.where(between_ns > 0, since_ns, 0) / np.maximum(between_ns, 1)
    xy = xy_m[before] + share[:, None] * (xy_m[after] - xy_m[before])
    yaw = wrap_angle(yaw_rad[before] + share * wrap_angle(yaw_rad[after] - yaw_rad[before]))
    xy[~valid], yaw[~valid] = np.nan, np.nan
    return xy, yaw, valid


def tag_to_base(tag_m: Float, yaw_rad: Float, x_m: float, y_m: float) -> Float:
    """Positions (N, 2) of base in map, from those of a tag that sits at (x_m, y_m) in base, and yaw (N,)."""
    return tag_m - turned(yaw_rad, np.array([x_m, y_m]))


def base_to_tag(base_m: Float, yaw_rad: Float, x_m: float, y_m: float) -> Float:
    """Positions (N, 2) of the tag in map, from those of base: the reverse of tag_to_base."""
    return base_m + turned(yaw_rad, np.array([x_m, y_m]))


def base_covariance(tag_covariance_m2: Float, yaw_rad: Float, yaw_std_rad: Float, x_m: float, y_m: float) -> Float:
    """Covariance (N, 2, 2) of tag_to_base's positions, from that of the tag's (N, 2, 2) and the std (N,) of yaw.

    To first order, with J = -dR/dyaw (x_m, y_m): the errors of tag and yaw are taken to be independent.
    """
    along_m = turned(yaw_rad, np.array([y_m, -x_m])) * yaw_std_rad[:, None]
    covariance: Float = tag_covariance_m2 + along_m[:, :, None] * along_m[:, None, :]
    return covariance


def turned(yaw_rad: Float, vector: Float) -> Float:
    """A vector (D,), or (N, ..., D), turned about z by yaw (N,): (N, D), or (N, ..., D)."""
    cos, sin, (x, y, *above) = np.cos(yaw_rad), np.sin(yaw_rad), vector.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, *above]).T


def arc_lengths(points: Float) -> Float:
    """Length along a polyline (K, 2) from its first point to each of its points, (K,)."""
    steps = points[1:] - points[:-1]
    lengths = np.zeros(len(points))
    np.cumsum(np.hypot(steps[:, 0], steps[:, 1]), out=lengths[1:])
    return lengths
