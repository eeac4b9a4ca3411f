from __future__ import annotations

import numpy as np
import pytest

from quadlog.lidar.classified_scan import ClassifiedReturns, ClassifiedScan, PointClass
from quadlog.lidar.deskew import Slots
from quadlog.lidar.ransac_plane import GroundPlane, height_above_ground
from quadlog.mapping.compact import CompactScan, CompactSettings, ObstacleSettings, ScanCompactor
from quadlog.mapping.grid import Window
from quadlog.mapping.placing import PlacedScan, ScanPlacer


@pytest.fixture(scope="session")
def compacted():
    """A function that makes a compact scan of points (N, 3) in base; label: of one class, or (N,) of many."""

    def make(
        xyz_m,
        label: PointClass | np.ndarray = PointClass.OBSTACLE,
        height_m=None,
        ground: GroundPlane | None = None,
        lidar_m=(0.0, 0.0, 0.5),
        slot=None,
        middle_ns=(0,),
        **settings,
    ) -> CompactScan:
        xyz_m = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)
        labels = np.broadcast_to(np.asarray(label, np.uint8), len(xyz_m)).copy()
        heights_m = height_above_ground(xyz_m, ground) if height_m is None else np.asarray(height_m)
        scan = ClassifiedScan(xyz_m.astype(np.float32), labels, ground, heights_m.astype(np.float32), "paper")
        slot = np.zeros(len(xyz_m), np.uint8) if slot is None else np.asarray(slot, np.uint8)
        slots = Slots(np.array(middle_ns, dtype=np.int64), None)
        returns = ClassifiedReturns.of_points(scan, np.array(lidar_m), slot, slots)
        chosen = CompactSettings(ObstacleSettings(), **settings)
        compact = ScanCompactor(chosen).compact(returns, 10**18)
        return CompactScan.from_bytes(compact.to_bytes())

    return make


@pytest.fixture(scope="session")
def placed():
    """A function that places a compact scan in a window; pose: (3,) at all time slots, or (K, 3)."""

    def make(
        compact: CompactScan,
        pose,
        window: Window,
        target_xy_m=(np.nan, np.nan),
        min_points: int = 1,
        radius_m: float = 0.5,
    ) -> PlacedScan:
        poses = np.broadcast_to(np.asarray(pose, dtype=np.float64), (len(compact.slot_ns), 3)).copy()
        return ScanPlacer(min_points, radius_m).place(compact, poses, target_xy_m, window)

    return make
