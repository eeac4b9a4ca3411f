"""Classify the returns of one scan after the other, without the robot's pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classified_scan import ClassifiedReturns, ClassifiedScan, PointClass
from quadlog.lidar.deskew import Slots, sweep_slots
from quadlog.lidar.paper_method import PaperSettings, classify_scan_paper
from quadlog.lidar.range_image_method import ImageClasses, RangeImageClassifier, RangeImageSettings, XyzM
from quadlog.lidar.ransac_plane import GroundPlane, is_level
from quadlog.messages import Float, PointCloud


class ScanClassifier:
    """Classifies the scans of one lidar, one after the other, in arrays that are kept from scan to scan.

    uses_times: whether the points' own times count; without them all of a scan is in one time slot.
    """

    def __init__(self, settings: RangeImageSettings | PaperSettings, seed: int = 0, *, uses_times: bool = True) -> None:
        self._uses_times = uses_times
        self._paper, self._seed = settings if isinstance(settings, PaperSettings) else None, seed
        self._images = RangeImageClassifier(settings) if isinstance(settings, RangeImageSettings) else None
        self._xyz_m, self._ring = np.zeros((3, 0), np.float32), np.zeros(0, np.uint16)
        self._slot = np.zeros(0, np.uint8)

    def classify(self, cloud: PointCloud, transform_lidar_to_level: Float) -> ClassifiedReturns:
        """The classified returns of a cloud; they are overwritten by the next one.

        transform_lidar_to_level: (4, 4) to base made upright, or (2, 4, 4) at the first and the last point's time.
        """
        transforms = transform_lidar_to_level.reshape(-1, 4, 4)
        slots = self._load(cloud)
        n = len(cloud.xyz_m)
        if self._images is None:
            return self._by_paper(cloud, transforms.mean(axis=0), slots)
        ring = self._ring[:n] if cloud.ring is not None and len(cloud.ring) == n else None
        x_m, y_m, z_m = self._xyz_m
        xyz_m = x_m[:n], y_m[:n], z_m[:n]
        last = max(len(slots.middle_ns) - 1, 1)
        moving = np.empty((2, 4, 4))
        moving[0], moving[1] = transforms[0], (transforms[-1] - transforms[0]) / last
        # Heights are measured, and the plane lies, about where the lidar is on average.
        moving[0, :3, 3], moving[1, :3, 3] = (transforms[0, :3, 3] + transforms[-1, :3, 3]) / 2, 0.0
        found = self._images.classify(xyz_m, ring, self._slot[:n], moving)
        return _as_returns(found, xyz_m, moving[0], slots)

    def _load(self, cloud: PointCloud) -> Slots:
        """Copy coordinates, rings and times from the message's payload."""
        n = len(cloud.xyz_m)
        if n > len(self._slot):
            room = n + n // 8
            self._xyz_m, self._ring = np.zeros((3, room), np.float32), np.zeros(room, np.uint16)
            self._slot = np.zeros(room, np.uint8)
        with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinity, which is no return
            for axis in range(3):
                np.copyto(self._xyz_m[axis, :n], cloud.xyz_m[:, axis], casting="same_kind")
        if cloud.ring is not None and len(cloud.ring) == n:
            self._ring[:n] = cloud.ring
        return sweep_slots(cloud.times if self._uses_times else None, self._slot[:n])

    def _by_paper(self, cloud: PointCloud, transform: Float, slots: Slots) -> ClassifiedReturns:
        assert self._paper is not None
        points = classify_scan_paper(cloud.xyz_m, transform, self._paper, self._seed)
        place_m = _above_ground(transform, points.ground)
        return ClassifiedReturns.of_points(points, place_m, self._slot[: len(points.label)], slots)


def _as_returns(found: ImageClasses, xyz_m: XyzM, transform: Float, slots: Slots) -> ClassifiedReturns:
    image = found.image
    n = image.rows * image.columns + image.n_others
    return ClassifiedReturns(
        dx_m=image.dx_m[:n],
        dy_m=image.dy_m[:n],
        z_m=image.z_m[:n],
        height_m=image.height_m[:n],
        label=image.label[:n],
        slot=image.slot[:n],
        rows=image.rows,
        columns=image.columns,
        counts=found.counts,
        ground=found.ground,
        route=found.route,
        lidar_base_m=_above_ground(transform, found.ground),
        slots=slots,
        points=lambda: _points(found, len(xyz_m[0]), transform),
    )


def _above_ground(transform: Float, ground: GroundPlane | None) -> Float:
    """The lidar (3,): x and y in base, and its height above the ground, of the plane where there is one."""
    x_m, y_m, z_m = transform[:3, 3].tolist()
    if is_level(ground):
        assert ground is not None
        nx, ny, nz = ground.normal.tolist()
        z_m = (nx * x_m + ny * y_m + nz * z_m + ground.d_m) / nz
    return np.array([x_m, y_m, z_m])


def _points(found: ImageClasses, n_points: int, transform: Float) -> ClassifiedScan:
    """Every point of the message with its class."""
    image, point = found.image, found.point_numbers()
    here = np.flatnonzero(np.concatenate([image.range_m[0] > 0, np.ones(image.n_others, np.bool_)]))
    xyz_m = np.full((3, n_points), np.nan, np.float32)
    heights_m, labels = np.full(n_points, np.nan, np.float32), np.zeros(n_points, np.uint8)
    at = point[here]
    lidar_x_m, lidar_y_m = transform[:2, 3].astype(np.float32)
    xyz_m[0, at], xyz_m[1, at], xyz_m[2, at] = (
        image.dx_m[here] + lidar_x_m,
        image.dy_m[here] + lidar_y_m,
        image.z_m[here],
    )
    heights_m[at], labels[at] = image.height_m[here], image.label[here]
    ground = found.ground
    if ground is not None:
        inliers: NDArray[np.bool_] = labels == PointClass.GROUND
        ground = GroundPlane(ground.normal, ground.d_m, inliers)
    return ClassifiedScan(xyz_m.T, labels, ground, heights_m, found.route)
