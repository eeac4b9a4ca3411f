"""The ground as one plane, found by RANSAC [Following].

Written here and not taken from Open3D, whose threads share one "best plane so far" and stop on it: which planes it
tries depends on how they are scheduled, and the same seed must give the same map. Open3D is the test's oracle instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import cached
from quadlog.messages import Float, Int

# Upper limit for very small inlier shares.
MOST_ITERATIONS = 100_000
# A steeper plane is a wall that RANSAC took for the ground: no heights are measured from it.
STEEPEST_GROUND_DEG = 45.0


@dataclass(frozen=True, slots=True)
class GroundPlane:
    """The plane normal . p + d_m = 0, with a unit normal (3,) that points up, and its inliers (N,) bool."""

    normal: Float
    d_m: float
    inliers: NDArray[np.bool_]


def ransac_iterations(confidence: float, inlier_share: float) -> int:
    """N = log(1 - p) / log(1 - w^3), rounded up, at least 1 and at most MOST_ITERATIONS. [Following]"""
    all_inliers = inlier_share**3
    if all_inliers >= 1.0:
        return 1
    if all_inliers <= 0.0:
        return MOST_ITERATIONS
    wanted = math.log(1.0 - confidence) / math.log1p(-all_inliers)
    return int(min(max(math.ceil(wanted), 1), MOST_ITERATIONS))


def fit_ground(
    xyz_m: Float, distance_m: float, confidence: float, inlier_share: float, min_points: int, seed: int
) -> GroundPlane | None:
    """The plane with the most of the finite points (N, 3) within distance_m, or None. [Following]

    N planes through three points each are tried, N from the confidence and the least inlier share expected, and lowered
    when a plane turns out to hold a larger share. The best is fitted to its inliers by least squares;
    `GroundPlane.inliers` are the points within distance_m of the fitted plane. None when fewer than min_points points
    are given, or lie on the plane, or when no three points span one.
    """
    if len(xyz_m) < max(min_points, 3):
        return None
    triples = _distinct_triples(len(xyz_m), ransac_iterations(confidence, inlier_share), seed)
    x, y, z = (np.ascontiguousarray(xyz_m[:, i], dtype=np.float64) for i in range(3))
    n_best, *plane = _best_plane(x, y, z, triples, distance_m, math.log(1.0 - confidence))
    if n_best == 0:
        return None
    on_plane = np.abs(plane[0] * x + plane[1] * y + plane[2] * z + plane[3]) <= distance_m
    normal, d_m = _least_squares_plane(xyz_m[on_plane])
    inliers = np.abs(normal[0] * x + normal[1] * y + normal[2] * z + d_m) <= distance_m
    return GroundPlane(normal, d_m, inliers) if np.count_nonzero(inliers) >= min_points else None


def _distinct_triples(n_points: int, n_triples: int, seed: int) -> Int:
    """(n_triples, 3) indices below n_points, different within each row."""
    generator = np.random.default_rng(seed)
    first = generator.integers(0, n_points, n_triples)
    second = generator.integers(0, n_points - 1, n_triples)
    third = generator.integers(0, n_points - 2, n_triples)
    # Each draw is from the indices that are left: step over the ones taken.
    second += second >= first
    low, high = np.minimum(first, second), np.maximum(first, second)
    third += third >= low
    third += third >= high
    return np.stack([first, second, third], axis=1)


def is_level(ground: GroundPlane | None) -> bool:
    """Whether there is a ground plane, and one that a robot could stand on."""
    return ground is not None and bool(ground.normal[2] >= math.cos(math.radians(STEEPEST_GROUND_DEG)))


def height_above_ground(xyz_base_m: Float, ground: GroundPlane | None) -> Float:
    """Vertical height (N,) of points (N, 3) above the plane; above base's own floor without a level plane.

    Without this rule a wall taken for the ground would hide every obstacle
    that stands farther from it than the greatest height.
    """
    if ground is None or not is_level(ground):
        floor: Float = xyz_base_m[:, 2]
        return floor
    above: Float = (xyz_base_m @ ground.normal + ground.d_m) / ground.normal[2]
    return above


@cached()
def _best_plane(
    x: Float, y: Float, z: Float, triples: Int, distance_m: float, log_miss: float
) -> tuple[int, float, float, float, float]:
    """Inlier count and (a, b, c, d) of the plane with the most inliers; the first one of equals."""
    n_best, best_a, best_b, best_c, best_d = 0, 0.0, 0.0, 0.0, 0.0
    n_needed = len(triples)
    for tried in range(len(triples)):
        if tried >= n_needed:
            break
        i, j, k = triples[tried]
        ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        norm = math.sqrt(a * a + b * b + c * c)
        if norm <= 1e-9 * math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)):
            continue  # three points on a line
        a, b, c = a / norm, b / norm, c / norm
        d = -(a * x[i] + b * y[i] + c * z[i])
        n_inliers = 0
        for p in range(len(x)):
            n_inliers += abs(a * x[p] + b * y[p] + c * z[p] + d) <= distance_m
        if n_inliers > n_best:
            n_best, best_a, best_b, best_c, best_d = n_inliers, a, b, c, d
            share_cubed = (n_inliers / len(x)) ** 3
            if share_cubed >= 1.0:
                break
            n_needed = min(n_needed, math.ceil(log_miss / math.log1p(-share_cubed)))
    return n_best, best_a, best_b, best_c, best_d


def _least_squares_plane(xyz_m: Float) -> tuple[Float, float]:
    """Unit normal (3,) pointing up and d of the plane nearest to the points in squared distance."""
    centroid = xyz_m.mean(axis=0)
    centred = xyz_m - centroid
    _, axes = np.linalg.eigh(centred.T @ centred)
    normal = axes[:, 0] if axes[2, 0] >= 0 else -axes[:, 0]
    return normal, float(-normal @ centroid)
