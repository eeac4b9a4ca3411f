"""Which points of a classified scan block the robot, and where they are in map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.classify import ClassifiedScan
from quadlog.lidar.points import PointClass, columns_of
from quadlog.messages import Float, Float32

_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)


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
    x_m, y_m, yaw_rad = (float(value) for value in pose_base_in_map)
    # A place that is not a number is near to nothing.
    target_x_m, target_y_m = (math.nan, math.nan) if target_xy_m is None else target_xy_m
    place = np.array([math.cos(yaw_rad), math.sin(yaw_rad), x_m, y_m, target_x_m, target_y_m])
    heights_m = np.array([settings.min_height_m, settings.max_height_m])
    points_m = np.empty((len(scan.label), 3))
    arrays = *columns_of(scan.xyz_base_m)[:2], scan.label, scan.height_m
    n = _pick_blocking(*arrays, heights_m, _half_body_m(settings), place, settings.target_radius_m**2, points_m)
    return points_m[:n]


def ray_ends(scan: ClassifiedScan, settings: ObstacleSettings) -> tuple[Float32, Float32]:
    """Where a scan's rays ended: (N, 3) in base and their heights (N,), NaN for points that are no surface.

    Outliers end where nothing is, and the robot's own body is nothing to look past.
    """
    height_m = np.empty(len(scan.label), np.float32)
    half_length_m, half_width_m = _half_body_m(settings)
    arrays = *columns_of(scan.xyz_base_m)[:2], scan.label, scan.height_m
    _keep_surfaces(*arrays, half_length_m, half_width_m, height_m)
    return scan.xyz_base_m, height_m


def _half_body_m(settings: ObstacleSettings) -> Float:
    return np.array([settings.body_length_m, settings.body_width_m]) / 2 + settings.body_margin_m


# Compiled, because every mask of a scan that numpy makes costs as much as this whole pass.
@njit(cache=True, error_model="numpy")
def _pick_blocking(
    base_x_m: Float32,
    base_y_m: Float32,
    label: NDArray[np.uint8],
    height_m: Float32,
    heights_m: Float,
    half_body_m: Float,
    place: Float,
    target_radius_m2: float,
    points_m: Float,
) -> int:
    cos, sin, x_m, y_m, target_x_m, target_y_m = place[0], place[1], place[2], place[3], place[4], place[5]
    n = 0
    for i in range(len(label)):
        if label[i] != _OBSTACLE or not heights_m[0] <= height_m[i] <= heights_m[1]:
            continue
        x, y = np.float64(base_x_m[i]), np.float64(base_y_m[i])
        if abs(x) <= half_body_m[0] and abs(y) <= half_body_m[1]:
            continue
        map_x, map_y = x_m + cos * x - sin * y, y_m + sin * x + cos * y
        dx, dy = map_x - target_x_m, map_y - target_y_m
        if dx * dx + dy * dy <= target_radius_m2:
            continue
        points_m[n, 0], points_m[n, 1], points_m[n, 2] = map_x, map_y, height_m[i]
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _keep_surfaces(
    base_x_m: Float32,
    base_y_m: Float32,
    label: NDArray[np.uint8],
    height_m: Float32,
    half_length_m: float,
    half_width_m: float,
    kept_m: Float32,
) -> None:
    length, width, none = np.float32(half_length_m), np.float32(half_width_m), np.float32(np.nan)
    for i in range(len(kept_m)):
        surface = (label[i] == _GROUND) | (label[i] == _OBSTACLE)
        beside = (abs(base_x_m[i]) > length) | (abs(base_y_m[i]) > width)
        kept_m[i] = height_m[i] if surface & beside else none
