"""The frame of a survey: that of its first pose, or of known anchors, whose places are compared with the survey's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.self_survey.batch import OdometryPrior, SurveySolution

CHI2_95 = 5.991
KNOWN_STD_M, MISPLACED = 0.1, 2.0
"""Known anchors contradict the survey beyond MISPLACED times the sum of KNOWN_STD_M and their 95 % bound."""


@dataclass(frozen=True, slots=True)
class FramedAnchors:
    """Anchors (A, 3) in the frame of the result, the covariance as a solution has it, and the first pose there."""

    anchors_m: Float
    covariance: Float
    start: Float
    aligned_to: int


def place_in_frame(solution: SurveySolution, drift: OdometryPrior, known_m: Float) -> FramedAnchors:
    """The solution in the frame of two or more known anchors (A, 2), else in that of the first pose.

    What turns and shifts all anchors alike is certain in the first case as far as it moves the known ones; in the
    second case the error of the first pose alone is added, that of 1 m of way and more.
    """
    anchors_m, n = solution.state.anchors_m, len(known_m)
    known = np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 2:
        gauge = np.zeros((len(solution.covariance), 3))
        gauge[: 3 * n] = _gauge(anchors_m)
        off_m, off_rad = np.hypot(solution.state.drift, drift.first_pose_std)
        variance = np.square([off_m, off_m, off_rad])
        return FramedAnchors(anchors_m, solution.covariance + (gauge * variance) @ gauge.T, np.zeros(3), 0)
    turn_rad, shift_m = _best_placing(anchors_m[known, :2], known_m[known])
    rotation = _turn(turn_rad)
    moved_m = anchors_m @ rotation.T + np.append(shift_m, 0.0)
    turned = np.eye(len(solution.covariance))
    turned[: 3 * n, : 3 * n] = np.kron(np.eye(n), rotation)
    covariance = relative_covariance(turned @ solution.covariance @ turned.T, moved_m, known)
    return FramedAnchors(moved_m, covariance, np.append(shift_m, turn_rad), len(known))


def _best_placing(anchors_m: Float, known_m: Float) -> tuple[float, Float]:
    """The turn and then the shift (2,) that bring points (B, 2) nearest to known ones (B, 2)."""
    centre_m, known_centre_m = anchors_m.mean(axis=0), known_m.mean(axis=0)
    off, known_off = (anchors_m - centre_m) @ [1, 1j], (known_m - known_centre_m) @ [1, 1j]
    turn_rad = float(np.angle((off.conj() * known_off).sum()))
    return turn_rad, known_centre_m - _turn(turn_rad)[:2, :2] @ centre_m


def _turn(yaw_rad: float) -> Float:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def misplaced(anchors_m: Float, framed: FramedAnchors, known_m: Float) -> tuple[dict[int, float], bool]:
    """Known anchors (A, 2) that are farther from their surveyed places than the bounds allow, index -> distance in m.

    And whether they all fit the mirror image of the survey (A, 3), which only three of them can tell.
    """
    known = np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 2:
        return {}, False
    blocks = [slice(3 * anchor, 3 * anchor + 3) for anchor in known]
    far_m = MISPLACED * np.array([KNOWN_STD_M + radius_95(framed.covariance[rows, rows]) for rows in blocks])

    def off_m(places_m: Float) -> Float:
        turn_rad, shift_m = _best_placing(places_m, known_m[known])
        return np.hypot(*(places_m @ _turn(turn_rad)[:2, :2].T + shift_m - known_m[known]).T)

    found_m = off_m(anchors_m[known, :2])
    misplaced_m = {int(known[row]): float(found_m[row]) for row in np.flatnonzero(found_m > far_m)}
    mirrored = len(known) > 2 and bool((off_m(anchors_m[known, :2] * [1, -1]) <= far_m).all())
    return misplaced_m, bool(misplaced_m) and mirrored


def radius_95(covariance_m2: Float) -> float:
    """How far the 95 % ellipse of x and y reaches; covariance_m2 (2, 2) or (3, 3)."""
    return float(np.sqrt(CHI2_95 * np.linalg.eigvalsh(covariance_m2[:2, :2])[-1]))


def relative_covariance(covariance: Float, anchors_m: Float, given: Int) -> Float:
    """The covariance in the frame in which the given anchors, by index, fit their places best."""
    gauge = np.zeros((len(covariance), 3))
    gauge[: 3 * len(anchors_m)] = _gauge(anchors_m)
    rows = (3 * given[:, None] + np.arange(2)).ravel()
    change = np.eye(len(covariance))
    change[:, rows] -= gauge @ np.linalg.pinv(gauge[rows])
    relative: Float = change @ covariance @ change.T
    return relative


def _gauge(anchors_m: Float) -> Float:
    """(3A, 3) how x, y, z of anchors (A, 3) move with a shift in x, in y, and a turn about the origin."""
    motion = np.zeros((len(anchors_m), 3, 3))
    motion[:, 0, 0] = motion[:, 1, 1] = 1.0
    motion[:, 0, 2], motion[:, 1, 2] = -anchors_m[:, 1], anchors_m[:, 0]
    return motion.reshape(-1, 3)
