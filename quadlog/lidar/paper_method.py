"""The paper's chain: crop to the front, statistical outliers, one RANSAC plane, obstacles. [Following]

Kept as published, with its limitations: after the crop a near wall holds more points than the floor, and is then
removed as the ground; and where no floor is in view, a level plane through the sensor itself wins, because every near
point lies close to it. Of a scan in a plane that would be every point, and nothing would block: there no ground is
looked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classified_scan import (
    FLATTEST_CLOUD,
    ClassifiedScan,
    GroundPlane,
    PointClass,
    Returns,
    class_counts,
    height_without_ground,
    lidar_above,
    outside_view,
)
from quadlog.messages import Float, Float32, Int

MOST_ITERATIONS = 100_000
"""Of RANSAC, for very small inlier shares."""
_PLANES_AT_ONCE = 8


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """Parameters of the paper's chain, as the configuration's sections `lidar` and `ground` explain them."""

    min_range_m: float = 0.3
    max_range_m: float = 30.0
    field_of_view_deg: float = 180.0
    outlier_neighbours: int = 20
    outlier_std_ratio: float = 2.0
    ground_distance_m: float = 0.1
    ground_confidence: float = 0.99
    ground_inlier_share: float = 0.3
    ground_min_points: int = 100


def classify_as_paper(
    xyz_lidar_m: Float,
    slot: NDArray[np.uint8],
    slot_ns: Int,
    transform_lidar_to_base: Float,
    settings: PaperSettings,
    seed: int,
) -> ClassifiedScan:
    """The class of every point of a scan (N, 3) in the lidar's frame; any values are accepted. [Following]

    slot: (N,) of the time slots with middles slot_ns (K,). The seed alone decides which planes are tried, so that a
    result does not depend on the scans before.
    """
    lidar_m = np.ascontiguousarray(xyz_lidar_m.T, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        squared = (lidar_m * lidar_m).sum(axis=0)
    # Drivers write "no return" as NaN, infinity, (0, 0, 0) or a huge number: one left in would spoil both filters.
    valid = (squared > 0) & (squared >= settings.min_range_m**2) & (squared <= settings.max_range_m**2)
    seen_m = np.where(valid, lidar_m, np.nan)
    base_m = transform_lidar_to_base[:3, :3] @ seen_m + transform_lidar_to_base[:3, 3:]
    # Whatever no filter explains must end in the map.
    label = np.full(len(valid), PointClass.OBSTACLE, np.uint8)
    label[outside_view(base_m[0], base_m[1], settings.field_of_view_deg)] = PointClass.CROPPED
    label[~valid] = PointClass.INVALID
    inside = np.flatnonzero(label == int(PointClass.OBSTACLE))
    outlier = statistical_outliers(base_m.T[inside], settings.outlier_neighbours, settings.outlier_std_ratio)
    label[inside[outlier]] = PointClass.OUTLIER
    inside = inside[~outlier]
    ground: GroundPlane | None = None
    height_m: Float32 = base_m[2].astype(np.float32)
    sine = lidar_m[2, inside] / np.sqrt(squared[inside])
    if len(sine) == 0 or np.ptp(sine) < FLATTEST_CLOUD:
        height_m = height_without_ground(height_m, float(transform_lidar_to_base[2, 3]))
    elif (found := fit_ground(base_m.T[inside], settings, seed)) is not None:
        ground, on_plane = found
        label[inside[on_plane]] = PointClass.GROUND
        # A wall that was taken for the ground would hide every obstacle farther from it than the greatest height.
        height_m = ground.height_m(base_m.T).astype(np.float32) if ground.is_level else height_m
    place_m = lidar_above(ground, transform_lidar_to_base)
    dx_m, dy_m = (base_m[:2] - place_m[:2, None]).astype(np.float32)
    returns = Returns(dx_m, dy_m, base_m[2].astype(np.float32), height_m, label, slot)
    return ClassifiedScan(returns, class_counts(label), 0, ground, "paper", place_m, slot_ns)


def statistical_outliers(xyz_m: Float, neighbours: int, std_ratio: float) -> NDArray[np.bool_]:
    """Which of the finite points (N, 3) are outliers: (N,) bool. [Following]

    D_i is the mean distance to the nearest `neighbours` points, the point itself excluded; a point stays when D_i < mu
    + std_ratio * sigma over the whole cloud (sigma with N - 1). A cloud of no more than `neighbours` points has no such
    D_i and no outliers. Open3D finds them; it also removes a point with `neighbours` exact duplicates.
    """
    from quadlog.open3d import import_open3d

    if len(xyz_m) <= neighbours:
        return np.zeros(len(xyz_m), dtype=np.bool_)
    geometry, utility = import_open3d().geometry, import_open3d().utility
    cloud = geometry.PointCloud(utility.Vector3dVector(xyz_m))
    # It counts the point itself as its own nearest neighbour, which scales all D_i alike.
    _, kept = cloud.remove_statistical_outlier(neighbours + 1, std_ratio)
    outlier = np.ones(len(xyz_m), dtype=np.bool_)
    outlier[np.asarray(kept, dtype=np.int64)] = False
    return outlier


def ransac_iterations(confidence: float, inlier_share: float) -> int:
    """N = log(1 - p) / log(1 - w^3), rounded up, at least 1 and at most MOST_ITERATIONS. [Following]"""
    with np.errstate(divide="ignore"):
        wanted = np.log(1.0 - confidence) / np.log1p(-(inlier_share**3))
    return int(np.clip(np.ceil(wanted), 1, MOST_ITERATIONS))


def fit_ground(xyz_m: Float, settings: PaperSettings, seed: int) -> tuple[GroundPlane, NDArray[np.bool_]] | None:
    """The plane with the most of the finite points (N, 3) within ground_distance_m, and which these are. [Following]

    N planes through three points each are tried, N from the confidence and the least inlier share expected, and lowered
    when a plane turns out to hold a larger share. The best, the first of equals, is fitted to its inliers by least
    squares. None when fewer than ground_min_points points are given, or lie on the plane, or when no three points span
    one. Not by Open3D, whose threads stop on the best plane so far: a seed would not decide which planes are tried.
    """
    distance_m, fewest, n = settings.ground_distance_m, settings.ground_min_points, len(xyz_m)
    if n < max(fewest, 3):
        return None
    n_needed = ransac_iterations(settings.ground_confidence, settings.ground_inlier_share)
    normals, d_m = _planes_through(xyz_m, _distinct_triples(n, n_needed, seed))
    best, n_best, across_m = -1, 0, np.ascontiguousarray(xyz_m.T)
    for begin in range(0, len(normals), _PLANES_AT_ONCE):
        if begin >= n_needed:
            break
        rows = slice(begin, begin + _PLANES_AT_ONCE)
        apart_m = normals[rows] @ across_m + d_m[rows, None]
        n_inliers = np.count_nonzero(np.abs(apart_m) <= distance_m, axis=1)
        if n_inliers.max() > n_best:
            best, n_best = begin + int(n_inliers.argmax()), int(n_inliers.max())
            n_needed = ransac_iterations(settings.ground_confidence, n_best / n)
    if n_best == 0:
        return None
    inliers = xyz_m[np.abs(xyz_m @ normals[best] + d_m[best]) <= distance_m]
    centroid = inliers.mean(axis=0)
    _, axes = np.linalg.eigh((inliers - centroid).T @ (inliers - centroid))
    normal = axes[:, 0] if axes[2, 0] >= 0 else -axes[:, 0]
    plane = GroundPlane(normal, float(-normal @ centroid))
    on_plane = np.abs(xyz_m @ normal + plane.d_m) <= distance_m
    return (plane, on_plane) if np.count_nonzero(on_plane) >= fewest else None


def _planes_through(xyz_m: Float, triples: Int) -> tuple[Float, Float]:
    """Normals (T, 3) and d (T,) of the planes through three points each; NaN for points on a line."""
    first, second, third = (xyz_m[triples[:, corner]] for corner in range(3))
    normals, sides = np.cross(second - first, third - first), (second - first, third - first)
    size, most = np.linalg.norm(normals, axis=1), np.prod([np.linalg.norm(each, axis=1) for each in sides], axis=0)
    normals /= np.where(size > 1e-9 * most, size, np.nan)[:, None]
    return normals, -np.sum(normals * first, axis=1)


def _distinct_triples(n_points: int, n_triples: int, seed: int) -> Int:
    """(n_triples, 3) indices below n_points, different within each row."""
    generator = np.random.default_rng(seed)
    first, step, other = (generator.integers(0, n_points - taken, n_triples) for taken in range(3))
    # The second lies 1 to n - 1 places on from the first, cyclically, and the third as many but for those.
    return np.stack([first, first + 1 + step, first + 1 + other + (other >= step)], axis=1) % n_points
