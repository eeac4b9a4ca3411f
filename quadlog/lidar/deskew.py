"""A scan measured while the robot moved, as it would have been measured in one instant.

A spinning lidar takes a tenth of a second for its points: at 0.7 m/s and
0.5 rad/s a wall 10 m away is drawn half a metre off at one end. Each point is
moved by what the robot moved between the point's own instant and the scan's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.geometry import invert_transform
from quadlog.lidar.points import columns_of
from quadlog.messages import Float, Float32, Int

MAX_OFFSET_NS = 1_000_000_000
"""No scan takes longer, and no stamp is farther from its points."""
KNOT_NS, SLOTS = 10_000_000, 128
"""Motion is linear from knot to knot, in so many steps: at 1.5 rad/s that is at most 3 mm off at 30 m."""
MAX_SPEED_MPS, MAX_TURN_RADPS = 10.0, 2 * math.pi
"""Faster poses jump, rather than that the robot moves."""
# Where the motion of the whole scan shifts no point within this range by more than this, there is none.
_NEGLIGIBLE_M, _FAR_M = 1e-3, 30.0


class Skewed(StrEnum):
    """Why a scan stays as it came."""

    NO_TIMES = "its points have no times of their own"
    ABSURD_TIMES = "the times of its points cannot be"
    NO_POSE = "no pose is known at the time of all its points"
    JUMP = "the poses jump while it lasts"


MOST_TIME_SLOTS = 32
"""A sweep of 0.1 s is cut into slots of 3 ms: at 1.5 rad/s half of one turns by 2 mrad, 2.4 cm at 10 m."""


@dataclass(frozen=True, slots=True)
class Slots:
    """Time slots of one scan: middle_ns (K,) their middles relative to the stamp; K is 1 without usable times.

    skewed: why there are none, or None.
    """

    middle_ns: Int
    skewed: Skewed | None


def sweep_slots(offset_ns: Int | None, slot: NDArray[np.uint8]) -> Slots:
    """When the time slots of a scan are; fills slot (N,) with that of every point, 0 without usable times.

    offset_ns: (N,) times of the points relative to the stamp, in any order. They may
    start, end or lie about 0; none farther from it than the scan lasts.
    """
    instants_ns = sweep_instants(0, offset_ns, len(slot))
    if isinstance(instants_ns, Skewed) or offset_ns is None:
        slot[:] = 0
        reason = instants_ns if isinstance(instants_ns, Skewed) else Skewed.NO_TIMES
        return Slots(np.zeros(1, np.int64), reason)
    first_ns, last_ns = int(instants_ns[1]), int(instants_ns[-1])
    lasts_ns = last_ns - first_ns
    middle_ns = first_ns + (2 * np.arange(MOST_TIME_SLOTS, dtype=np.int64) + 1) * lasts_ns // (2 * MOST_TIME_SLOTS)
    _fill_slots(offset_ns, first_ns, np.float32(MOST_TIME_SLOTS * 0.99999 / lasts_ns), slot)
    return Slots(middle_ns, None)


@njit(cache=True, error_model="numpy")
def _fill_slots(offset_ns: Int, first_ns: int, per_ns: float, slot: NDArray[np.uint8]) -> None:
    for i in range(len(slot)):
        slot[i] = np.uint8(np.float32(offset_ns[i] - first_ns) * per_ns)


def slot_poses(t_ns: int, slot_ns: Int, pose_base_in_map: Float) -> tuple[Float, Skewed | None]:
    """Poses (K, 3) of base in map at the scan's time slots, and why they are all that of the stamp, or None.

    slot_ns: (K,) absolute; pose_base_in_map: (1 + K, 3) x, y, yaw at t_ns and at the slots, NaN where unknown.
    """
    at_stamp = np.tile(pose_base_in_map[0], (len(slot_ns), 1))
    if len(slot_ns) == 1:
        return at_stamp, None
    if not np.isfinite(pose_base_in_map).all():
        return at_stamp, Skewed.NO_POSE
    if _jumps(np.concatenate([np.array([t_ns], dtype=np.int64), slot_ns]), pose_base_in_map):
        return at_stamp, Skewed.JUMP
    return pose_base_in_map[1:], None


def sweep_instants(t_ns: int, offset_ns: Int | None, n_points: int) -> Int | Skewed:
    """The scan's instant t_ns, and after it those (K,) between which motion is linear: where poses are needed.

    offset_ns: (N,) times of the points relative to t_ns, in any order. They may
    start, end or lie about 0; none farther from it than the scan lasts.
    """
    if offset_ns is None or n_points == 0:
        return Skewed.NO_TIMES
    if offset_ns.shape != (n_points,):
        return Skewed.ABSURD_TIMES
    first_ns, last_ns = int(offset_ns.min()), int(offset_ns.max())
    lasts_ns = last_ns - first_ns
    if lasts_ns == 0:
        return Skewed.NO_TIMES
    if lasts_ns > MAX_OFFSET_NS or max(first_ns, -last_ns) > lasts_ns or max(-first_ns, last_ns) > MAX_OFFSET_NS:
        return Skewed.ABSURD_TIMES
    n_steps = -(-lasts_ns // KNOT_NS)
    knots_ns = t_ns + first_ns + np.arange(n_steps + 1, dtype=np.int64) * lasts_ns // n_steps
    return np.concatenate([np.array([t_ns], dtype=np.int64), knots_ns])


def deskew(
    xyz_lidar_m: Float,
    offset_ns: Int,
    instants_ns: Int,
    pose_base_in_map: Float,
    rotation_base_to_level: Float,
    transform_lidar_to_base: Float,
) -> Float | Skewed:
    """Points (N, 3) float32, each in the lidar's frame of its own instant, moved into its frame of the scan's instant.

    offset_ns: (N,) as given to `sweep_instants`, and instants_ns (1 + K,) what
    it returned; pose_base_in_map: (1 + K, 3) x_m, y_m, yaw_rad there, NaN where
    unknown; rotation_base_to_level: (1 + K, 3, 3) there. The same array comes
    back when the robot stood still. What is not a return (NaN, zero) stays so.
    """
    if not np.isfinite(pose_base_in_map).all():
        return Skewed.NO_POSE
    if _jumps(instants_ns, pose_base_in_map):
        return Skewed.JUMP
    transform_to_map = _lidar_to_map(pose_base_in_map, rotation_base_to_level, transform_lidar_to_base)
    to_scan = invert_transform(transform_to_map[0]) @ transform_to_map[1:]
    change = to_scan[:, :3] - np.eye(4)[:3]
    if (np.abs(change[:, :, 3]).max(axis=1) + _FAR_M * np.abs(change[:, :, :3]).max(axis=(1, 2))).max() < _NEGLIGIBLE_M:
        return xyz_lidar_m
    first_ns, lasts_ns = int(instants_ns[1] - instants_ns[0]), int(instants_ns[-1] - instants_ns[1])
    x_m, y_m, z_m = columns_of(xyz_lidar_m)
    moved_m = np.empty((3, len(x_m)), np.float32)
    _move(x_m, y_m, z_m, offset_ns, first_ns, lasts_ns, _slots(change), *moved_m)
    return moved_m.T


def _jumps(t_ns: Int, pose: Float) -> bool:
    in_order = np.argsort(t_ns, kind="stable")
    step_s = np.diff(t_ns[in_order]) * 1e-9
    step = np.diff(pose[in_order], axis=0)
    turn_rad = np.abs((step[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    too_fast = np.hypot(step[:, 0], step[:, 1]) > MAX_SPEED_MPS * step_s
    return bool((too_fast | (turn_rad > MAX_TURN_RADPS * step_s)).any())


def _lidar_to_map(pose: Float, rotation_base_to_level: Float, transform_lidar_to_base: Float) -> Float:
    """(M, 4, 4) transforms R_z(yaw) R_y(pitch) R_x(roll) (mount) + position. [Following, as corrected]"""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    heading = np.tile(np.eye(4), (len(pose), 1, 1))
    heading[:, 0, 0], heading[:, 0, 1], heading[:, 1, 0], heading[:, 1, 1] = cos, -sin, sin, cos
    heading[:, :2, 3] = pose[:, :2]
    tilt = np.tile(np.eye(4), (len(pose), 1, 1))
    tilt[:, :3, :3] = rotation_base_to_level
    transform: Float = heading @ tilt @ transform_lidar_to_base
    return transform


def _slots(change: Float) -> Float32:
    """(S, 12): SLOTS changes from each of (K, 3, 4) to the next, so that points need no interpolation."""
    flat = change.reshape(-1, 12).astype(np.float32)
    share = np.arange(SLOTS, dtype=np.float32)[:, None] / np.float32(SLOTS)
    between = flat[:-1, None] + share * np.diff(flat, axis=0)[:, None]
    return np.concatenate([between.reshape(-1, 12), flat[-1:]])


@njit(cache=True, error_model="numpy")
def _move(
    x_m: Float32,
    y_m: Float32,
    z_m: Float32,
    offset_ns: Int,
    first_ns: int,
    lasts_ns: int,
    changes: Float32,
    moved_x_m: Float32,
    moved_y_m: Float32,
    moved_z_m: Float32,
) -> None:
    """Each point by that of the changes (S, 12), even in time, transforms less the identity, nearest to its time."""
    last = len(changes) - 1
    per_ns = np.float32(last / lasts_ns)
    for i in range(len(x_m)):
        x, y, z = x_m[i], y_m[i], z_m[i]
        slot = int(np.float32(offset_ns[i] - first_ns) * per_ns + np.float32(0.5))
        m = changes[min(max(slot, 0), last)]
        # What is no return (0, 0, 0) stays so.
        returned = np.float32(1) if (x != 0) | (y != 0) | (z != 0) else np.float32(0)
        moved_x_m[i] = x + returned * (m[0] * x + m[1] * y + m[2] * z + m[3])
        moved_y_m[i] = y + returned * (m[4] * x + m[5] * y + m[6] * z + m[7])
        moved_z_m[i] = z + returned * (m[8] * x + m[9] * y + m[10] * z + m[11])
