"""Rigid transforms on plain arrays: 4x4 matrices named transform_A_to_B, quaternions as xyzw, yaw about z."""

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


def quat_from_yaw(yaw_rad: Float) -> Float:
    """Quaternions (..., 4) as x, y, z, w that turn by yaw about z."""
    half = np.asarray(yaw_rad, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def quat_from_euler(yaw_rad: Float, pitch_rad: Float, roll_rad: Float) -> Float:
    """Quaternions (N, 4) as x, y, z, w of R_z(yaw) R_y(pitch) R_x(roll), angles (N,)."""
    (cz, sz), (cy, sy), (cx, sx) = ((np.cos(half), np.sin(half)) for half in (yaw_rad / 2, pitch_rad / 2, roll_rad / 2))
    quat = [
        cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx,
        cz * cy * cx + sz * sy * sx,
    ]
    # Adding 0 turns the -0 of a level walker into 0.
    return np.stack(quat, axis=-1) + 0.0


def wrap_angle(angle_rad: Float) -> Float:
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
