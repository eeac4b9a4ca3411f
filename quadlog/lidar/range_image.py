"""Scans of spinning lidars: organised into a range image, false points by isolation, ground by walking columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.beams import Beams, beams_by_bins, beams_by_elevation, beams_by_ring
from quadlog.lidar.classify import FLATTEST_CLOUD, MOUNT_KNOWN_M, ClassifiedScan, Route, height_without_ground
from quadlog.lidar.column_walk import walk_columns
from quadlog.lidar.ground import Ground
from quadlog.lidar.ground_profile import SECTOR_COLUMNS, ground_profile, level_plane, profile_height
from quadlog.lidar.height_map import classify_unorganised, drop_isolated
from quadlog.lidar.image import Image, range_image
from quadlog.lidar.isolation import BOTH_LAYERS, isolate, supported
from quadlog.lidar.points import PointClass, columns_of, in_field_of_view
from quadlog.lidar.polar import Polar, to_polar
from quadlog.messages import Float, Float32

FEWEST_BEAMS = 3
"""Below that no slope from beam to beam tells ground from walls: everything is an obstacle."""
MOST_TILT_COSINE = 0.7
"""A lidar that leans farther than 45 degrees has no columns to walk outwards along."""
NEAR_FLOOR_M = 5.0
# Height off the ground of what is ground: after the walk said so, without it, and at the foot of a wall.
_WALKED_M, _LEVEL_M, _FOOT_M, _SUNKEN_M = np.float32(0.10), np.float32(0.04), np.float32(0.01), np.float32(-0.3)

_INVALID, _OUTLIER = np.uint8(PointClass.INVALID), np.uint8(PointClass.OUTLIER)
_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)
_UNSEEN = np.uint8(255)


@dataclass(frozen=True, slots=True)
class RangeImageSettings:
    """Parameters of this method, as the configuration's sections `lidar` and `ground` explain them."""

    min_range_m: float = 0.3
    max_range_m: float = 30.0
    field_of_view_deg: float = 360.0
    ground_min_points: int = 100


def classify_scan_range_image(
    xyz_lidar_m: Float,
    ring: NDArray[np.uint16] | None,
    transform_lidar_to_base: Float,
    settings: RangeImageSettings,
) -> ClassifiedScan:
    """The class of every point of a scan (N, 3) in the lidar's frame, whatever is in it.

    ring: (N,) beam numbers in any order, or None; numbers that contradict the
    elevations are not believed. The whole scan is looked at, also where only
    a field of view is kept: what is beside it helps to judge what is in it.
    """
    transform: Float = np.ascontiguousarray(transform_lidar_to_base, dtype=np.float64)
    polar = to_polar(xyz_lidar_m, transform, float(settings.min_range_m), float(settings.max_range_m))
    upright = float(transform[2, 2])
    route: Route = "rings"
    beams = beams_by_ring(polar, ring, upright > 0)
    if beams is None:
        route, beams = "elevations", beams_by_elevation(polar, upright > 0)
    if beams is None or abs(upright) < MOST_TILT_COSINE:
        route, transform = "height_map", _unturned(transform)
        polar = to_polar((polar.xyz_base_m - transform[:3, 3]).astype(np.float32), transform, 0.0, np.inf)
        label, height_m, plane = _classify_bins(polar, transform)
    else:
        label, height_m, plane = _classify_beams(polar, beams, transform)
    if settings.field_of_view_deg < 360:
        beside = ~in_field_of_view(polar.xyz_base_m, settings.field_of_view_deg)
        label[beside & (label != _INVALID)] = np.uint8(PointClass.CROPPED)
    return ClassifiedScan(
        polar.xyz_base_m, label, _as_ground(plane, label, settings.ground_min_points), height_m, route
    )


def _unturned(transform: Float) -> Float:
    """The transform from axes parallel to base's at the lidar's place."""
    moved = np.eye(4)
    moved[:3, 3] = transform[:3, 3]
    return moved


def _as_ground(plane: Float, label: NDArray[np.uint8], min_points: int) -> Ground | None:
    inliers: NDArray[np.bool_] = label == _GROUND
    if np.count_nonzero(inliers) < min_points:
        return None
    size = float(np.sqrt(plane[0] ** 2 + plane[1] ** 2 + 1.0))
    return Ground(np.array([-plane[0], -plane[1], 1.0]) / size, -float(plane[2]) / size, inliers)


def _classify_beams(polar: Polar, beams: Beams, transform: Float) -> tuple[NDArray[np.uint8], Float32, Float]:
    x_m, y_m, z_m = (float(each) for each in transform[:3, 3])
    rows = len(beams.descending)
    if rows < FEWEST_BEAMS:
        return _all_obstacles(polar, transform)
    image = range_image(polar, beams, x_m, y_m)
    good, distance_m, height_m = isolate(image, z_m)
    floor_m = 0.0 if z_m > MOUNT_KNOWN_M else _floor_below(good, height_m, beams.descending, z_m)
    ground, wall = walk_columns(good, distance_m, height_m, image.range_m[0], beams.descending, floor_m)
    plane = level_plane(ground, polar.xyz_base_m, image.point)
    outward_slope = _outward_slopes(plane, beams.columns, transform)
    profile = ground_profile(ground, distance_m, height_m, floor_m, outward_slope)
    label, above_m = _label(polar, image, (good, ground, wall), (distance_m, height_m), profile, transform)
    return label, above_m, plane


def _classify_bins(polar: Polar, transform: Float) -> tuple[NDArray[np.uint8], Float32, Float]:
    sine = polar.sine[polar.range_m > 0]
    if len(sine) == 0 or np.ptp(sine) < FLATTEST_CLOUD:
        return _all_obstacles(polar, transform)
    z_m = float(transform[2, 3])
    if z_m > MOUNT_KNOWN_M:
        return classify_unorganised(polar, transform, 0.0)
    # The lowest twentieth of what is near lies on the floor, or on what stands for it.
    near = polar.xyz_base_m[(polar.range_m > 0) & (polar.range_m < NEAR_FLOOR_M), 2]
    return classify_unorganised(polar, transform, float(np.quantile(near, 0.05)) if len(near) else z_m)


def _all_obstacles(polar: Polar, transform: Float) -> tuple[NDArray[np.uint8], Float32, Float]:
    """Whatever neighbours support, at its height above base's floor."""
    x_m, y_m, z_m = (float(each) for each in transform[:3, 3])
    image = range_image(polar, beams_by_bins(polar), x_m, y_m)
    good, _, _ = isolate(image, z_m)
    label = np.empty(len(polar.range_m), np.uint8)
    drop_isolated(polar.range_m, image.range_m, image.cell, image.point, good, label)
    return label, height_without_ground(polar.xyz_base_m[:, 2].copy(), z_m), np.zeros(3)


def _floor_below(good: NDArray[np.bool_], z_m: Float32, descending: NDArray[np.bool_], lidar_z_m: float) -> float:
    """Half of what the lowest beam that returns anything sees lies on the floor, unless the lidar is walled in."""
    for row in np.flatnonzero(descending):
        seen = z_m[row][good[row]]
        if len(seen) >= good.shape[1] // 20:
            return float(np.median(seen))
    return lidar_z_m


def _outward_slopes(plane: Float, columns: int, transform: Float) -> Float32:
    """How much the plane rises per metre in the middle of each sector."""
    sectors = -(-columns // SECTOR_COLUMNS)
    azimuth_rad = (np.arange(sectors) + 0.5) * (SECTOR_COLUMNS / columns * 2 * np.pi)
    outward = np.column_stack([np.cos(azimuth_rad), np.sin(azimuth_rad)]) @ transform[:2, :2].T
    slopes: Float32 = (outward @ plane[:2] / np.linalg.norm(outward, axis=1)).astype(np.float32)
    return slopes


def _label(
    polar: Polar,
    image: Image,
    marks: tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]],
    places_m: tuple[Float32, Float32],
    profile: Float32,
    transform: Float,
) -> tuple[NDArray[np.uint8], Float32]:
    """Class and height above the ground (N,) of every point, also of those that share a cell with a nearer one.

    marks: which cells are good, ground, and near a wall; places_m: their smoothed distance and z.
    """
    label, above_m = np.full(len(polar.range_m), _UNSEEN, np.uint8), np.empty(len(polar.range_m), np.float32)
    _label_cells(*marks, *places_m, image.point, profile, label, above_m)
    points = *columns_of(polar.xyz_base_m), polar.range_m, polar.turn, image.cell
    x_m, y_m = float(transform[0, 3]), float(transform[1, 3])
    _label_others(*points, image.range_m, profile, x_m, y_m, label, above_m)
    return label, above_m


@njit(cache=True, error_model="numpy")
def _label_cells(
    good: NDArray[np.bool_],
    ground: NDArray[np.bool_],
    wall: NDArray[np.bool_],
    distance_m: Float32,
    z_m: Float32,
    point: NDArray[np.int32],
    profile: Float32,
    label: NDArray[np.uint8],
    above_m: Float32,
) -> None:
    """The points that stand for a good cell."""
    for row in range(good.shape[0]):
        for c in range(good.shape[1]):
            if not good[row, c]:
                continue
            above = z_m[row, c] - profile_height(profile, c, distance_m[row, c])
            near = _FOOT_M if wall[row, c] else (_WALKED_M if ground[row, c] else _LEVEL_M)
            sunken = ground[row, c] and _SUNKEN_M < above < 0
            i = np.uint32(point[row, c])
            label[i] = _GROUND if abs(above) <= near or sunken else _OBSTACLE
            above_m[i] = above


@njit(cache=True, error_model="numpy")
def _label_others(
    base_x_m: Float32,
    base_y_m: Float32,
    base_z_m: Float32,
    ranges_m: Float32,
    turn: Float32,
    cells: NDArray[np.int32],
    range_m: Float32,
    profile: Float32,
    x_m: float,
    y_m: float,
    label: NDArray[np.uint8],
    above_m: Float32,
) -> None:
    """Points that share a cell with a nearer one, have none, or are alone in it."""
    columns, x0, y0 = range_m.shape[2], np.float32(x_m), np.float32(y_m)
    for i in range(len(label)):
        if label[i] != _UNSEEN:
            continue
        if ranges_m[i] == 0:
            label[i], above_m[i] = _INVALID, np.nan
            continue
        cell = cells[i]
        row, c = (cell // columns, cell % columns) if cell >= 0 else (0, int(turn[i] * columns))
        dx, dy = base_x_m[i] - x0, base_y_m[i] - y0
        above_m[i] = base_z_m[i] - profile_height(profile, c, np.sqrt(dx * dx + dy * dy))
        label[i] = _GROUND if abs(above_m[i]) <= _LEVEL_M else _OBSTACLE
        if cell >= 0 and not supported(range_m, BOTH_LAYERS, row, c, ranges_m[i]):
            label[i] = _OUTLIER
