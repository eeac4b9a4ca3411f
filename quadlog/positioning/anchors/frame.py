"""The frame of a survey: that of its first pose, or of known anchors, whose places are compared with the survey's."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.anchors.check import MATTERS_M, SIGNIFICANT_STD, AnchorShift, SurveyFaults
from quadlog.positioning.anchors.walk import OdometryPrior
from quadlog.positioning.ellipses import CHI2_95

KNOWN_STD_M, MISPLACED = 0.1, 2.0
"""Known anchors contradict the survey beyond MISPLACED times the sum of KNOWN_STD_M and their 95 % bound."""
RIVAL_CHI2 = 6.0
"""Faults whose misfits differ by less are alternatives: the likelihoods' ratio is below 20."""
EXPLAINED_CHI2 = 5.0
"""Misfit for each degree of freedom up to which a single fault explains the places."""


@dataclass(frozen=True, slots=True)
class FramedAnchors:
    """Anchors (A, 3) in the frame of the result, the covariance as a solution has it, and the first pose there."""

    anchors_m: Float
    covariance: Float
    start: Float
    aligned_to: int


def place_in_frame(
    anchors_m: Float, covariance: Float, drift: tuple[float, float], odometry: OdometryPrior, known_m: Float
) -> FramedAnchors:
    """Anchors (A, 3) of a walk that drifts, in the frame of two or more known ones (A, 2), else of the first pose.

    covariance: of the anchors, then of anything else. What turns and shifts all anchors alike is certain in the first
    case as far as it moves the known ones; in the second case the error of the first pose alone is added, that of 1 m
    of way and more.
    """
    n, known = len(known_m), np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 2:
        gauge = np.zeros((len(covariance), 3))
        gauge[: 3 * n] = _gauge(anchors_m)
        off_m, off_rad = np.hypot(drift, odometry.first_pose_std)
        variance = np.square([off_m, off_m, off_rad])
        return FramedAnchors(anchors_m, covariance + (gauge * variance) @ gauge.T, np.zeros(3), 0)
    turn_rad, shift_m = _best_placing(anchors_m[known, :2], known_m[known])
    rotation = _turn(turn_rad)
    moved_m = anchors_m @ rotation.T + np.append(shift_m, 0.0)
    change = np.eye(len(covariance))
    change[: 3 * n, : 3 * n] = np.kron(np.eye(n), rotation)
    covariance = relative_covariance(change @ covariance @ change.T, moved_m, known)
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

    And whether they all fit the mirror image of the survey (A, 3), which only three of them can exclude.
    """
    known = np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 2:
        return {}, False
    blocks = [slice(3 * anchor, 3 * anchor + 3) for anchor in known]
    far_m = MISPLACED * np.array([KNOWN_STD_M + reach_95(framed.covariance[rows, rows]) for rows in blocks])

    def off_m(places_m: Float) -> Float:
        """(B,) how far places (B, 2), turned and shifted as fits best, are from the known ones."""
        turn_rad, shift_m = _best_placing(places_m, known_m[known])
        return np.hypot(*(places_m @ _turn(turn_rad)[:2, :2].T + shift_m - known_m[known]).T)

    found_m = off_m(anchors_m[known, :2])
    misplaced_m = {int(known[row]): float(found_m[row]) for row in np.flatnonzero(found_m > far_m)}
    mirrored = len(known) > 2 and bool((off_m(anchors_m[known, :2] * [1, -1]) <= far_m).all())
    return misplaced_m, bool(misplaced_m) and mirrored


def find_faults(framed: FramedAnchors, known_m: Float, numbers: Int) -> SurveyFaults | None:
    """Two known anchors (A, 2) that are exchanged, or one elsewhere, by generalised least squares of all places.

    They are named by their numbers (A,). Each fault is fitted together with the turn and shift of the frame. None where
    no single fault explains the places, and with fewer than three known anchors, which say nothing of one another.
    """
    known = np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 3:
        return None
    rows = (3 * known[:, None] + np.arange(2)).ravel()
    covariance_m2 = framed.covariance[np.ix_(rows, rows)] + KNOWN_STD_M**2 / 2 * np.eye(len(rows))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_m2))
    gauge = _gauge(framed.anchors_m).reshape(-1, 3, 3)[known, :2].reshape(-1, 3)
    freedom = len(rows) - 3

    def fit(places_m: Float, free: Float) -> tuple[float, Float, Float]:
        """The misfit with columns (2A, K) free, their values (K,) and covariance (K, K)."""
        design, off = whiten @ np.hstack([gauge, free]), whiten @ (framed.anchors_m[known, :2] - places_m).ravel()
        inverse = np.linalg.pinv(design.T @ design)
        value = inverse @ design.T @ off
        return float(np.sum((off - design @ value) ** 2)), value[3:], inverse[3:, 3:]

    nothing, places_m, index = np.empty((len(rows), 0)), known_m[known], np.arange(len(known))
    as_given, _, _ = fit(places_m, nothing)
    swaps = {
        (i, j): fit(places_m[np.where(index == i, j, np.where(index == j, i, index))], nothing)[0]
        for i, j in combinations(index.tolist(), 2)
    }
    shifts = {k: fit(places_m, np.eye(len(rows))[:, 2 * k : 2 * k + 2]) for k in index.tolist()}
    best = min([*swaps.values(), *(misfit for misfit, _, _ in shifts.values())])
    if as_given - best <= SIGNIFICANT_STD**2:
        return SurveyFaults()
    if best > EXPLAINED_CHI2 * freedom:
        return None
    swapped = sorted((pair for pair in swaps if swaps[pair] < best + RIVAL_CHI2), key=lambda pair: swaps[pair])
    likely = sorted((k for k in shifts if shifts[k][0] < best + RIVAL_CHI2), key=lambda k: shifts[k][0])
    named = numbers[known].tolist()
    shifted = [AnchorShift(named[k], *shifts[k][1:], 0.0) for k in likely]
    return SurveyFaults(
        tuple((named[i], named[j]) for i, j in swapped),
        shifted=tuple(each for each in shifted if each.distance_m > MATTERS_M),
    )


def reach_95(covariance_m2: Float) -> float:
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
