"""Which points of a classified scan block the robot, and where they are in map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classify import ClassifiedScan
from quadlog.lidar.points import PointClass
from quadlog.messages import Float


@dataclass(frozen=True, slots=True)
class ObstacleSettings:
    """What counts as an obstacle.

    min_height_m, max_height_m: above the ground; lower and higher points do not block.
    target_radius_m: points this near to the target are the target.
    body_length_m, body_width_m, body_margin_m: points in this box about base's origin are the robot.
    """

    min_height_m: float = 0.05
    max_height_m: float = 1.5
    target_radius_m: float = 0.5
    body_length_m: float = 0.62
    body_width_m: float = 0.26
    body_margin_m: float = 0.1


def obstacle_points(
    scan: ClassifiedScan, pose_base_in_map: Float, target_xy_m: Float | None, settings: ObstacleSettings
) -> Float:
    """The points (M, 3) that block the robot: x and y in map, and height above the ground. [Following]

    pose_base_in_map: (3,) x, y in metres and yaw in radians.
    target_xy_m: (2,) in map, or None when nothing is followed.
    """
    is_obstacle = scan.label == PointClass.OBSTACLE
    xyz_base_m, height_m = scan.xyz_base_m[is_obstacle], scan.height_m[is_obstacle]
    blocks = (height_m >= settings.min_height_m) & (height_m <= settings.max_height_m)
    blocks &= ~_on_body(xyz_base_m, settings)
    points_m = np.column_stack([to_map(xyz_base_m[blocks, :2], pose_base_in_map), height_m[blocks]])
    if target_xy_m is None:
        return points_m
    from_target_m = np.hypot(points_m[:, 0] - target_xy_m[0], points_m[:, 1] - target_xy_m[1])
    others: Float = points_m[from_target_m > settings.target_radius_m]
    return others


def ray_ends(scan: ClassifiedScan, settings: ObstacleSettings) -> tuple[Float, NDArray]:
    """Where a scan's rays ended: (N, 3) in base and their heights (N,), NaN for points that are no surface.

    Outliers end where nothing is, and the robot's own body is nothing to look past.
    """
    surface = (scan.label == PointClass.GROUND) | (scan.label == PointClass.OBSTACLE)
    surface &= ~_on_body(scan.xyz_base_m, settings)
    return scan.xyz_base_m, np.where(surface, scan.height_m, np.nan)


def to_map(xy_base_m: Float, pose_base_in_map: Float) -> Float:
    """Points (N, 2) of base turned by the pose's yaw and moved by its position: (N, 2) in map. [Following]"""
    x_m, y_m, yaw_rad = (float(value) for value in pose_base_in_map)
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    rotation_base_to_map = np.array([[cosine, -sine], [sine, cosine]])
    moved: Float = xy_base_m @ rotation_base_to_map.T + np.array([x_m, y_m])
    return moved


def _on_body(xyz_base_m: Float, settings: ObstacleSettings) -> NDArray[np.bool_]:
    half_length_m = settings.body_length_m / 2 + settings.body_margin_m
    half_width_m = settings.body_width_m / 2 + settings.body_margin_m
    on_body: NDArray[np.bool_] = np.abs(xyz_base_m[:, 0]) <= half_length_m
    return on_body & (np.abs(xyz_base_m[:, 1]) <= half_width_m)
