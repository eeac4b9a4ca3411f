"""Every point of a classified scan, kept until positions are known; to be replaced by compact scans."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.config import Config
from quadlog.lidar.classify import ClassifiedScan
from quadlog.lidar.deskew import Skewed, sweep_instants
from quadlog.lidar.ground import Ground, height_above_ground
from quadlog.lidar.paper import PaperSettings, classify_scan_paper
from quadlog.lidar.points import columns_of
from quadlog.lidar.range_image import RangeImageSettings, classify_scan_range_image
from quadlog.mapping.accumulated import AccumulatedMap
from quadlog.mapping.ground_height import GroundHeight
from quadlog.mapping.memory import Memory
from quadlog.mapping.obstacles import ObstacleSettings, obstacle_points, ray_ends
from quadlog.mapping.occupancy import obstacle_tops
from quadlog.mapping.rays import lowest_rays
from quadlog.mapping.window import window_around
from quadlog.messages import Float, Int, PointCloud

SLOTS = 32


class Returns(NamedTuple):
    points: ClassifiedScan
    lidar_base_m: Float
    slot: NDArray[np.uint8]
    middle_ns: Int
    skewed: Skewed | None


class Classifier:
    def __init__(self, config: Config, seed: int) -> None:
        lidar, ground = config.lidar, config.ground
        self._paper = PaperSettings(
            min_range_m=lidar.min_range_m,
            max_range_m=lidar.max_range_m,
            field_of_view_deg=lidar.field_of_view_deg or 180.0,
            outlier_neighbours=lidar.outlier_neighbours,
            outlier_std_ratio=lidar.outlier_std_ratio,
            ground_distance_m=ground.distance_m,
            ground_confidence=ground.confidence,
            ground_inlier_share=ground.inlier_share,
            ground_min_points=ground.min_points,
        )
        self._image = RangeImageSettings(
            min_range_m=lidar.min_range_m,
            max_range_m=lidar.max_range_m,
            field_of_view_deg=lidar.field_of_view_deg or 360.0,
            ground_min_points=ground.min_points,
        )
        self._by_paper, self._seed, self._deskews = lidar.method == "paper", seed, lidar.deskew

    def classify(self, cloud: PointCloud, transforms: Float) -> Returns:
        transform = transforms.mean(axis=0)
        if self._by_paper:
            points = classify_scan_paper(cloud.xyz_m, transform, self._paper, self._seed)
        else:
            points = classify_scan_range_image(cloud.xyz_m, cloud.ring, transform, self._image)
        place_m = transform[:3, 3].copy()
        place_m[2] = float(height_above_ground(place_m[None], points.ground)[0])
        offset_ns = cloud.offset_ns if self._deskews else None
        instants_ns = sweep_instants(0, offset_ns, len(cloud.xyz_m))
        if isinstance(instants_ns, Skewed) or offset_ns is None:
            skewed = instants_ns if isinstance(instants_ns, Skewed) else Skewed.NO_TIMES
            return Returns(points, place_m, np.zeros(len(points.label), np.uint8), np.zeros(1, np.int64), skewed)
        first_ns, last_ns = int(offset_ns.min()), int(offset_ns.max())
        lasts_ns = last_ns - first_ns
        middle_ns = first_ns + (2 * np.arange(SLOTS, dtype=np.int64) + 1) * lasts_ns // (2 * SLOTS)
        slot = np.minimum((offset_ns - first_ns) * SLOTS // lasts_ns, SLOTS - 1).astype(np.uint8)
        return Returns(points, place_m, slot, middle_ns, None)


def to_bytes(returns: Returns) -> bytes:
    points = returns.points
    arrays = [*columns_of(points.xyz_base_m), points.height_m]
    parts = [np.asarray(each, np.float32).tobytes() for each in arrays]
    return b"".join([returns.lidar_base_m.tobytes(), *parts, points.label.tobytes(), returns.slot.tobytes()])


def deskewed(xyz_m: Float, slot: NDArray[np.uint8], pose: Float, slot_pose: Float) -> Float:
    """Points (N, 3) of base in base at the scan's pose (3,), each by the pose of its slot (K, 3)."""
    x_m, y_m, yaw = (slot_pose - pose).T
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    shift = np.column_stack([cos * x_m + sin * y_m, -sin * x_m + cos * y_m])[slot]
    cos, sin = np.cos(yaw)[slot], np.sin(yaw)[slot]
    x, y, z = xyz_m.T
    return np.stack([cos * x - sin * y + shift[:, 0], sin * x + cos * y + shift[:, 1], z]).astype(np.float32).T


class Mapper:
    def __init__(self, config: Config, memory: Memory) -> None:
        self.memory, self._config = memory, config
        self.whole = AccumulatedMap(config.grid.cell_m)
        self.ground = GroundHeight(config.results.ground_cell_m)
        self._settings = ObstacleSettings(
            min_height_m=config.grid.min_height_m,
            max_height_m=config.grid.max_height_m,
            target_radius_m=config.grid.target_radius_m,
            body_length_m=config.robot.length_m,
            body_width_m=config.robot.width_m,
        )

    def add(
        self,
        t_ns: int,
        data: bytes,
        ground: Ground | None,
        level: bool,
        pose: Float,
        slot_pose: Float,
        target: Float | None,
    ) -> tuple[Float, NDArray[np.bool_]]:
        """Origin of the window and its occupied cells."""
        n = (len(data) - 24) // 18
        place_m = np.frombuffer(data, np.float64, 3)
        floats = np.frombuffer(data, np.float32, 4 * n, 24).reshape(4, n)
        label, slot = np.frombuffer(data, np.uint8, 2 * n, 24 + 16 * n).reshape(2, n).copy()
        xyz_m = deskewed(floats[:3].T, slot, pose, slot_pose)
        scan = ClassifiedScan(xyz_m, label, ground, floats[3].copy(), "rings")
        grid, settings = self._config.grid, self._settings
        window = window_around(pose[:2], grid.cell_m, grid.size_cells)
        top_m = obstacle_tops(obstacle_points(scan, pose, target, settings), window, grid.min_points)
        lowest_ray_m = lowest_rays(place_m.copy(), *ray_ends(scan, settings), pose, window)
        occupied = self.memory.add(t_ns, window, top_m, lowest_ray_m)
        # What a ray passes above the robot's back may still be in its way.
        self.whole.add(window, np.isfinite(top_m), lowest_ray_m < self._config.robot.height_m)
        # A wall that was taken for the ground says nothing about where the floor is.
        if level:
            self.ground.add(xyz_m, label, pose)
        return window.origin_m, occupied
