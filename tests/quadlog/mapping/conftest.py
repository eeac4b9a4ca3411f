from __future__ import annotations

import numpy as np
import pytest

from quadlog.lidar.classified_scan import ClassifiedScan, GroundPlane, PointClass, Returns, class_counts
from quadlog.mapping.grid import Window
from quadlog.mapping.placing import PlacedScan, PlacingSettings, place_scan


@pytest.fixture(scope="session")
def scanned():
    """A function that makes a classified scan of points (N, 3) in base; label: of one class, or (N,) of many."""

    def make(
        xyz_m,
        label: PointClass | np.ndarray = PointClass.OBSTACLE,
        height_m=None,
        ground: GroundPlane | None = None,
        lidar_m=(0.0, 0.0, 0.5),
        slot=None,
    ) -> ClassifiedScan:
        xyz_m = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)
        labels = np.broadcast_to(np.asarray(label, np.uint8), len(xyz_m)).copy()
        if height_m is None:
            height_m = xyz_m[:, 2] if ground is None or not ground.is_level else ground.height_m(xyz_m)
        slot = np.zeros(len(xyz_m), np.uint8) if slot is None else np.asarray(slot, np.uint8)
        place_m = np.array(lidar_m)
        x_m, y_m, z_m = np.float32(xyz_m - [*place_m[:2], 0]).T.copy()
        returns = Returns(x_m, y_m, z_m, np.float32(height_m), labels, slot)
        return ClassifiedScan(returns, class_counts(labels), 0, ground, "paper", place_m, np.zeros(1, np.int64))

    return make


@pytest.fixture(scope="session")
def placed():
    """A function that places a scan in a window; pose: (3,) at all time slots, or (K, 3)."""

    def make(scan: ClassifiedScan, pose, window: Window, target_xy_m=(np.nan, np.nan), **settings) -> PlacedScan:
        poses = np.broadcast_to(np.asarray(pose, dtype=np.float64), (32, 3)).copy()
        return place_scan(scan, poses, window, np.array(target_xy_m), PlacingSettings(**settings))

    return make
