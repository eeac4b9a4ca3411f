"""The paper's chain: crop to the front, statistical outliers, one RANSAC plane, obstacles. [Following]

Kept as published, with its limitations: after the crop a near wall holds more points than the floor, and is then
removed as the ground; and where no floor is in view, a level plane through the sensor itself wins, because every near
point lies close to it. Of a scan in a plane that would be every point, and nothing would block: there no ground is
looked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.lidar.classified_scan import (
    FLATTEST_CLOUD,
    ClassifiedScan,
    PointClass,
    cropped_to_base,
    height_without_ground,
)
from quadlog.lidar.ransac_plane import GroundPlane, fit_ground, height_above_ground
from quadlog.lidar.statistical_outliers import statistical_outliers
from quadlog.messages import Float


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


def classify_scan_paper(
    xyz_lidar_m: Float, transform_lidar_to_base: Float, settings: PaperSettings, seed: int
) -> ClassifiedScan:
    """The class of every point of a scan (N, 3) in the lidar's frame; any values are accepted. [Following]

    The seed alone decides which planes are tried, so that a scan's result does not depend on the scans before it.
    """
    xyz_base_m, label = cropped_to_base(
        xyz_lidar_m,
        transform_lidar_to_base,
        settings.min_range_m,
        settings.max_range_m,
        settings.field_of_view_deg,
    )
    inside = np.flatnonzero(label == PointClass.OBSTACLE)
    outlier = statistical_outliers(xyz_base_m[inside], settings.outlier_neighbours, settings.outlier_std_ratio)
    label[inside[outlier]] = PointClass.OUTLIER

    inside = inside[~outlier]
    if _is_flat(xyz_lidar_m[inside]):
        z_m = xyz_base_m[:, 2].astype(np.float32)
        height_m = height_without_ground(z_m, float(transform_lidar_to_base[2, 3]))
        return ClassifiedScan(xyz_base_m.astype(np.float32), label, None, height_m, "paper")
    plane = fit_ground(
        xyz_base_m[inside],
        settings.ground_distance_m,
        settings.ground_confidence,
        settings.ground_inlier_share,
        settings.ground_min_points,
        seed,
    )
    ground = None
    if plane is not None:
        label[inside[plane.inliers]] = PointClass.GROUND
        ground = GroundPlane(plane.normal, plane.d_m, label == PointClass.GROUND)
    height_m = height_above_ground(xyz_base_m, ground).astype(np.float32)
    return ClassifiedScan(xyz_base_m.astype(np.float32), label, ground, height_m, "paper")


def _is_flat(xyz_lidar_m: Float) -> bool:
    """Whether returns (N, 3) in the lidar's frame lie in one plane through it."""
    sine = xyz_lidar_m[:, 2] / np.linalg.norm(xyz_lidar_m, axis=1)
    return len(sine) == 0 or bool(np.ptp(sine) < FLATTEST_CLOUD)
