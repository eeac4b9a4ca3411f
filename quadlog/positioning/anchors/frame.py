"""The frame of a survey: that of its first pose, or of known anchors, whose places are compared with the survey's."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.alignment import rigid_motion
from quadlog.positioning.ellipses import ellipse_95

KNOWN_STD_M, MISPLACED = 0.1, 2.0
"""Known anchors contradict the survey beyond MISPLACED times the sum of KNOWN_STD_M and their 95 % bound."""


def place_in_frame(anchors_m: Float, covariance: Float, known_m: Float, start_std: Float) -> tuple[Float, Float, Float]:
    """Anchors (A, 3) in the frame of two or more known ones (A, 2), else in that of the first pose; their covariance.

    covariance: of the anchors, then of anything else, in the first case relative to the known ones; in the second with
    the error of the first pose, start_std (3,) in m, m and rad. The last value is the first pose (3,) in that frame.
    """
    n, known = len(known_m), np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 2:
        moves = gauge(anchors_m, len(covariance))
        return anchors_m, covariance + (moves * start_std**2) @ moves.T, np.zeros(3)
    rotation = np.eye(3)
    rotation[:2, :2], shift_m = rigid_motion(anchors_m[known, :2], known_m[known])
    moved_m, turn_rad = anchors_m @ rotation.T + np.append(shift_m, 0.0), np.arctan2(rotation[1, 0], rotation[0, 0])
    change = np.eye(len(covariance))
    change[: 3 * n, : 3 * n] = np.kron(np.eye(n), rotation)
    return moved_m, relative_covariance(change @ covariance @ change.T, moved_m, known), np.append(shift_m, turn_rad)


def misplaced(anchors_m: Float, covariance: Float, known_m: Float) -> tuple[dict[int, float], bool]:
    """Known anchors (A, 2) off by more than the bounds: index -> m; whether all of 3 or more fit the mirror image."""
    known = np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 2:
        return {}, False
    blocks = np.array([covariance[3 * k : 3 * k + 2, 3 * k : 3 * k + 2] for k in known])
    far_m = MISPLACED * (KNOWN_STD_M + ellipse_95(blocks)[0])
    off_m = np.hypot(*(anchors_m[known, :2] - known_m[known]).T)
    image_m = anchors_m[known, :2] * [1, -1]
    rotation, shift_m = rigid_motion(image_m, known_m[known])
    image_off_m = np.hypot(*(image_m @ rotation.T + shift_m - known_m[known]).T)
    misplaced_m = {int(known[row]): float(off_m[row]) for row in np.flatnonzero(off_m > far_m)}
    return misplaced_m, bool(misplaced_m) and len(known) > 2 and bool((image_off_m <= far_m).all())


def relative_covariance(covariance: Float, anchors_m: Float, given: Int) -> Float:
    """The covariance in the frame in which the given anchors, by index, fit their places best."""
    moves = gauge(anchors_m, len(covariance))
    rows = (3 * given[:, None] + np.arange(2)).ravel()
    change = np.eye(len(covariance))
    change[:, rows] -= moves @ np.linalg.pinv(moves[rows])
    return np.asarray(change @ covariance @ change.T)


def gauge(anchors_m: Float, size: int) -> Float:
    """(size, 3) how x, y, z of anchors (A, 3) move with a shift in x, in y, and a turn about the origin, zero after."""
    motion, x, y = np.zeros((size, 3)), slice(0, anchors_m.size, 3), slice(1, anchors_m.size, 3)
    motion[x, 0] = motion[y, 1] = 1.0
    motion[x, 2], motion[y, 2] = -anchors_m[:, 1], anchors_m[:, 0]
    return motion
