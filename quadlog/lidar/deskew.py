"""Deskewing: time slots of a scan's points, and the robot's pose at each slot.

A spinning lidar takes a tenth of a second for its points: at 0.7 m/s and
0.5 rad/s a wall 10 m away is drawn half a metre off at one end. Points are
gathered in time slots, and each slot is placed by the robot's pose at its middle.
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int, PointTimes

MAX_OFFSET_NS = 1_000_000_000
"""Upper limit of a scan's duration and of the distance between its stamp and its points."""
MAX_SPEED_MPS, MAX_TURN_RADPS = 10.0, 2 * math.pi
"""Faster changes of pose are taken for jumps."""


class Skewed(StrEnum):
    """Why a scan is not deskewed."""

    NO_TIMES = "its points have no timestamps"
    ABSURD_TIMES = "the timestamps of its points are implausible"
    NO_POSE = "no pose is known for the whole scan"
    JUMP = "the poses jump during the scan"


MOST_TIME_SLOTS = 32
"""A sweep of 0.1 s is cut into slots of 3 ms: at 1.5 rad/s half of one turns by 2 mrad, 2.4 cm at 10 m."""


def sweep_span(times: PointTimes | None, n_points: int) -> tuple[int, int] | Skewed:
    """The times of the first and the last of N points relative to the stamp, or why they cannot be used."""
    if times is None or n_points == 0:
        return Skewed.NO_TIMES
    if times.value.shape != (n_points,):
        return Skewed.ABSURD_TIMES
    first_ns, last_ns = times.first_ns, times.last_ns
    lasts_ns = last_ns - first_ns
    if lasts_ns == 0:
        return Skewed.NO_TIMES
    if lasts_ns > MAX_OFFSET_NS or max(-first_ns, last_ns) > MAX_OFFSET_NS:
        return Skewed.ABSURD_TIMES
    return first_ns, last_ns


def sweep_slots(times: PointTimes | None, n_points: int) -> tuple[NDArray[np.uint8], Int]:
    """The time slot (N,) of each point, and middles (K,) of the slots after the stamp; one slot without good times."""
    span_ns = sweep_span(times, n_points)
    if isinstance(span_ns, Skewed) or times is None:
        return np.zeros(n_points, np.uint8), np.zeros(1, np.int64)
    first_ns, last_ns = span_ns
    middle_ns = first_ns + (2 * np.arange(MOST_TIME_SLOTS) + 1) * (last_ns - first_ns) // (2 * MOST_TIME_SLOTS)
    # From the first one on, so that no digit is lost of seconds since 1970.
    low, high = times.value.min(), times.value.max()
    since = (times.value - low).astype(np.float32, copy=False)
    since *= np.float32(MOST_TIME_SLOTS * 0.99999) / np.float32(high - low)
    return since.astype(np.uint8), middle_ns


def slot_poses(t_ns: Int, pose_base_in_map: Float) -> tuple[Float, list[Skewed | None]]:
    """Poses (S, K, 3) of base in map at the time slots of scans, and why those of a scan are its stamp's, or None.

    t_ns: (S, 1 + K) each scan's stamp and slots; pose_base_in_map: (S, 1 + K, 3) x, y, yaw there, NaN where unknown.
    """
    in_order = np.argsort(t_ns, axis=1, kind="stable")
    step_s = np.diff(np.take_along_axis(t_ns, in_order, 1)) * 1e-9
    step = np.diff(np.take_along_axis(pose_base_in_map, in_order[..., None], 1), axis=1)
    turn_rad = np.abs((step[..., 2] + np.pi) % (2 * np.pi) - np.pi)
    too_fast = np.hypot(step[..., 0], step[..., 1]) > MAX_SPEED_MPS * step_s
    jumps = (too_fast | (turn_rad > MAX_TURN_RADPS * step_s)).any(axis=1)
    known = np.asarray(np.isfinite(pose_base_in_map).all(axis=(1, 2)))
    has_slots = t_ns.shape[1] > 2
    good = known & ~jumps & has_slots
    bad = [Skewed.JUMP if each else Skewed.NO_POSE for each in known.tolist()]
    why = [None if fits or not has_slots else each for fits, each in zip(good.tolist(), bad, strict=True)]
    return np.where(good[:, None, None], pose_base_in_map[:, 1:], pose_base_in_map[:, :1]), why
