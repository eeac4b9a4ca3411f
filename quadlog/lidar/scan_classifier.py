"""The class of every return of a scan, without the robot's pose: what the one pass over a recording asks of a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classify import FEWEST_RETURNS, ClassifiedScan, Route
from quadlog.lidar.deskew import Skewed, Slots, sweep_slots
from quadlog.lidar.ground import Ground, height_above_ground
from quadlog.lidar.paper import PaperSettings, classify_scan_paper
from quadlog.lidar.points import PointClass, columns_of
from quadlog.lidar.range_image import RangeImageSettings, classify_scan_range_image
from quadlog.messages import Float, Float32, PointCloud


@dataclass(frozen=True, slots=True)
class ClassifiedReturns:
    """The returns of one scan in base, levelled, as they were measured: nothing is deskewed.

    x_m, y_m, z_m, height_m (above the ground), label (of PointClass), slot (time slot): (M,) each; the first
    rows * columns of them are the cells of the range image, row by row, INVALID where nothing returned; the rest, or
    all where columns is 0, are in no order. All are overwritten by the next scan of the same classifier.
    counts: (5,) points of the message by PointClass. ground: the plane, its inliers left empty, or None.
    lidar_base_m: (3,) where the lidar stands, its z above the ground.
    """

    x_m: Float32
    y_m: Float32
    z_m: Float32
    height_m: Float32
    label: NDArray[np.uint8]
    slot: NDArray[np.uint8]
    columns: int
    rows: int
    counts: NDArray[np.int64]
    ground: Ground | None
    route: Route
    lidar_base_m: Float
    slots: Slots
    _points: ClassifiedScan

    @property
    def shows_nothing(self) -> bool:
        """Whether a map would be wrong to say anything because of this scan: an empty one is no sight of free space."""
        return int(self.counts[PointClass.GROUND] + self.counts[PointClass.OBSTACLE]) < FEWEST_RETURNS

    @property
    def skewed(self) -> Skewed | None:
        """Why the points have no times that could be used, None where they have."""
        return self.slots.skewed

    def points(self) -> ClassifiedScan:
        """Every point of the message with its class, in the message's order: costs more than classifying."""
        return self._points


class ScanClassifier:
    """Classifies the scans of one lidar, one after the other, in arrays that are kept from scan to scan."""

    def __init__(self, settings: RangeImageSettings | PaperSettings, seed: int = 0) -> None:
        self._settings, self._seed = settings, seed

    def classify(self, cloud: PointCloud, transform_lidar_to_level: Float) -> ClassifiedReturns:
        """transform_lidar_to_level: (4, 4) to base made upright, or (2, 4, 4) at the first and the last point's time."""
        transforms = np.asarray(transform_lidar_to_level, dtype=np.float64).reshape(-1, 4, 4)
        transform: Float = transforms.mean(axis=0)
        if isinstance(self._settings, PaperSettings):
            points = classify_scan_paper(cloud.xyz_m, transform, self._settings, self._seed)
        else:
            points = classify_scan_range_image(cloud.xyz_m, cloud.ring, transform, self._settings)
        slot, slots = sweep_slots(cloud.offset_ns, len(cloud.xyz_m))
        lidar_base_m = transform[:3, 3].copy()
        lidar_base_m[2] = float(height_above_ground(lidar_base_m[None], points.ground)[0])
        counts = np.bincount(points.label, minlength=len(PointClass))
        xyz_m = columns_of(points.xyz_base_m)
        of_points = points.height_m, points.label, slot
        place = points.ground, points.route, lidar_base_m
        return ClassifiedReturns(*xyz_m, *of_points, 0, 0, counts, *place, slots, points)
