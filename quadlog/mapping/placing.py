"""A classified scan on the grid around the robot: what was hit in each cell, and how low it was seen through.

Nothing in a scan is deskewed: each return carries the time slot in which it was measured, so that one rigid transform
per slot puts it where it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass, Returns
from quadlog.mapping.grid import Window
from quadlog.mapping.ray_tracing import lowest_rays
from quadlog.messages import Float, Float32

# How far the lidar lies from the middle of the window: its mount, half a cell, and what it moves while it sweeps.
_LIDAR_OFF_M = 1.0
_OBSTACLE = np.uint8(PointClass.OBSTACLE)
# So that heights stay within 16 bits.
_HIGHEST_MM = np.float32(32000)
NO_TOP = np.int16(-32768)
"""Height, in mm, of the highest obstacle point in a cell in which nothing was hit."""


@dataclass(frozen=True, slots=True)
class PlacingSettings:
    """Which returns block a cell.

    min_height_m, max_height_m: above the ground; lower and higher points do not block. body_length_m, body_width_m,
    body_margin_m: points in this box about base's origin are the robot. highest_m: how high above the ground rays
    still matter. min_points: a cell with fewer obstacle points is not hit. target_radius_m: points nearer to the
    target than this are the target.
    """

    min_height_m: float = 0.05
    max_height_m: float = 1.5
    body_length_m: float = 0.62
    body_width_m: float = 0.26
    body_margin_m: float = 0.1
    highest_m: float = 1.6
    min_points: int = 1
    target_radius_m: float = 0.5


class PlacedScan(NamedTuple):
    """Cells (rows, cols) int16, in mm above the ground.

    top_mm: the highest obstacle point, NO_TOP where there is none. lowest_ray_mm: how low the cell was seen through,
    NO_RAY where no ray crossed it.
    """

    top_mm: NDArray[np.int16]
    lowest_ray_mm: NDArray[np.int16]


def reach_of(scan: ClassifiedScan, window: Window) -> float:
    """How far from the lidar the corners of a window about the robot lie at most, in metres."""
    return window.cell_m * math.hypot(*window.shape) / 2 + _LIDAR_OFF_M + math.hypot(*scan.lidar_base_m[:2])


def place_scan(
    scan: ClassifiedScan, slot_pose_base_in_map: Float, window: Window, target_xy_m: Float, settings: PlacingSettings
) -> PlacedScan:
    """Tops and lowest rays of a scan in a window; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots.

    target_xy_m: (2,) in map, NaN when nothing is followed. In a scan without ground, as a 2-D scanner's, one point is
    enough for a cell to be hit: a wall has no more.
    """
    placed = PlacedScan(*np.empty((2, *window.shape), np.int16))
    half_body_m = np.array([settings.body_length_m, settings.body_width_m]) / 2 + settings.body_margin_m
    heights_m = settings.min_height_m, settings.max_height_m
    limits = np.array([*scan.lidar_base_m[:2], *half_body_m, *heights_m], np.float32)
    # A place that is not a number is near to nothing.
    place = np.array([window.col0, window.row0, window.cell_m, *target_xy_m, settings.target_radius_m**2], np.float64)
    fewest = settings.min_points if scan.count(PointClass.GROUND) else 1
    _raise_tops(scan.returns, limits, slot_pose_base_in_map, place, fewest, placed.top_mm)
    reach_m, highest_m = reach_of(scan, window), settings.highest_m
    lowest_rays(scan, half_body_m, highest_m, slot_pose_base_in_map, window, reach_m, placed.lowest_ray_mm)
    return placed


@inner
def slot_transforms(poses: Float) -> Float:
    """(K, 4) cosine and sine of the yaw, and x, y, of poses (K, 3) x, y, yaw at the time slots."""
    moved = np.empty((len(poses), 4))
    for k in range(len(poses)):
        moved[k, 0], moved[k, 1] = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        moved[k, 2], moved[k, 3] = poses[k, 0], poses[k, 1]
    return moved


@kernel
def _raise_tops(
    returns: Returns, limits: Float32, poses: Float, place: Float, min_points: int, top_mm: NDArray[np.int16]
) -> None:
    """limits: the lidar's x and y in base, half of the body, and the heights that block. place: the window's first
    column and row on the lattice, the edge of a cell, and the target's place and squared radius.
    """
    dx_m, dy_m, height_m, label, slot = returns.dx_m, returns.dy_m, returns.height_m, returns.label, returns.slot
    rows, cols = top_mm.shape
    top_mm[:] = NO_TOP
    counts = min_points > 1
    count = np.zeros((rows, cols) if counts else (0, 0), np.int32)
    moved, per_cell = slot_transforms(poses), 1.0 / place[2]
    for i in range(len(label)):
        above = height_m[i]
        if label[i] != _OBSTACLE or not limits[4] <= above <= limits[5]:
            continue
        x, y, at = dx_m[i] + limits[0], dy_m[i] + limits[1], slot[i]
        if abs(x) <= limits[2] and abs(y) <= limits[3]:
            continue
        map_x_m = moved[at, 2] + moved[at, 0] * x - moved[at, 1] * y
        map_y_m = moved[at, 3] + moved[at, 1] * x + moved[at, 0] * y
        dx, dy = map_x_m - place[3], map_y_m - place[4]
        col, row = math.floor(map_x_m * per_cell) - place[0], math.floor(map_y_m * per_cell) - place[1]
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        inside = col >= 0.0 and col < cols and row >= 0.0 and row < rows
        if inside and not dx * dx + dy * dy <= place[5]:
            at_row, at_col = np.uint32(row), np.uint32(col)
            millimetres = np.int16(min(above * np.float32(1000), _HIGHEST_MM))
            top_mm[at_row, at_col] = max(top_mm[at_row, at_col], millimetres)
            if counts:
                count[at_row, at_col] += 1
    if counts:
        for r in range(rows):
            for c in range(cols):
                if count[r, c] < min_points:
                    top_mm[r, c] = NO_TOP
