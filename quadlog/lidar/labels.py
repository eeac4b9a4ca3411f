"""The class and the height of every return of an image, from its ground, its walls and the ground's profile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.lidar.column_walk import ColumnWalk
from quadlog.lidar.ground_profile import GroundProfile, profile_height
from quadlog.lidar.image import Image
from quadlog.lidar.isolation import Isolated, supported
from quadlog.lidar.points import PointClass
from quadlog.messages import Float32, Int

Marks = NDArray[np.int8]

# Height off the ground of what is ground: after the walk said so, without it, and at the foot of a wall.
_WALKED_M, _LEVEL_M, _FOOT_M, _SUNKEN_M = np.float32(0.10), np.float32(0.04), np.float32(0.01), np.float32(-0.3)
_INVALID, _CROPPED, _OUTLIER = (np.uint8(each) for each in (PointClass.INVALID, PointClass.CROPPED, PointClass.OUTLIER))
_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)


def label_returns(image: Image, isolated: Isolated, walked: ColumnWalk, profile: GroundProfile, counts: Int) -> None:
    """Fill the image's label and height_m, and add the points of each class to counts (5,)."""
    table = profile.height_m.reshape(-1), profile.first, profile.second, profile.across
    marks = isolated.good, walked.ground, walked.wall
    _label_cells(
        *marks, isolated.distance_m, isolated.z_m, image.range_m[0], *table, image.height_m, image.label, counts
    )
    if image.n_others:
        others = image.n_others, image.other_range_m, image.other_cell, image.range_m
        _label_others(*others, image.dx_m, image.dy_m, image.z_m, *table, image.height_m, image.label, counts)


def crop_to_view(image: Image, lidar_xy_m: tuple[float, float], field_of_view_deg: float, counts: Int) -> None:
    """Label CROPPED what lies beside a fan about base's x axis, and correct counts. [Following]"""
    n = image.rows * image.columns + image.n_others
    half_rad = np.deg2rad(field_of_view_deg) / 2
    x_m, y_m = image.dx_m[:n] + np.float32(lidar_xy_m[0]), image.dy_m[:n] + np.float32(lidar_xy_m[1])
    label = image.label[:n]
    # |azimuth| <= half  <=>  sin(half - |azimuth|) >= 0, multiplied by the range.
    inside = np.sin(half_rad) * x_m >= np.cos(half_rad) * np.abs(y_m)
    label[~inside & (label != _INVALID)] = _CROPPED
    n_invalid = counts[_INVALID]
    counts[:] = np.bincount(label, minlength=len(counts))
    counts[_INVALID] = n_invalid


def label_supported(image: Image, isolated: Isolated, counts: Int) -> None:
    """Label every return an obstacle where neighbours support it, else an outlier, and add them to counts (5,)."""
    cells = image.rows * image.columns
    seen = image.range_m[0] > 0
    image.label[:cells] = np.where(seen, np.where(isolated.good.reshape(-1) != 0, _OBSTACLE, _OUTLIER), _INVALID)
    if image.n_others:
        others = image.n_others, image.other_range_m, image.other_cell
        _judge_others(*others, image.range_m, image.columns, image.label)
    label = image.label[: cells + image.n_others]
    counts[_OUTLIER:] += np.bincount(label, minlength=len(counts))[_OUTLIER:]


@kernel
def _judge_others(
    n_others: int,
    other_range_m: Float32,
    other_cell: NDArray[np.int32],
    range_m: Float32,
    columns: int,
    label: NDArray[np.uint8],
) -> None:
    cells = range_m.shape[1]
    for other in range(n_others):
        row, c = other_cell[other] // columns, other_cell[other] % columns
        real = supported(range_m, columns, 2, row, c, other_range_m[other])
        label[cells + other] = _OBSTACLE if real else _OUTLIER


@kernel
def _label_cells(
    good: Marks,
    ground: Marks,
    wall: Marks,
    distance_m: Float32,
    z_m: Float32,
    range_m: Float32,
    heights_m: Float32,
    first: NDArray[np.int32],
    second: NDArray[np.int32],
    across: Float32,
    height_m: Float32,
    label: NDArray[np.uint8],
    counts: Int,
) -> None:
    """The nearest return of every cell: INVALID where there is none, OUTLIER where it is not supported."""
    rows, columns = good.shape
    none = np.float32(0)
    n_ground, n_obstacle, n_outlier = 0, 0, 0
    for row in range(rows):
        begin = row * columns
        distance, z, is_good, is_ground, is_wall = distance_m[row], z_m[row], good[row], ground[row], wall[row]
        # An index the compiler cannot see to be positive would keep the loops from becoming vector instructions.
        above_m, classes, ranges_m = height_m[begin:], label[begin:], range_m[begin:]
        for c in range(columns):
            above_m[c] = z[c] - profile_height(heights_m, first, second, across, c, distance[c])
        for c in range(columns):
            above = above_m[c]
            near = _FOOT_M if is_wall[c] != 0 else (_WALKED_M if is_ground[c] != 0 else _LEVEL_M)
            sunken = (is_ground[c] != 0) & (above < none) & (above > _SUNKEN_M)
            surface = _GROUND if (abs(above) <= near) | sunken else _OBSTACLE
            alone = _OUTLIER if ranges_m[c] > none else _INVALID
            classes[c] = surface if is_good[c] != 0 else alone
        for c in range(columns):
            n_ground += classes[c] == _GROUND
            n_obstacle += classes[c] == _OBSTACLE
            n_outlier += classes[c] == _OUTLIER
    counts[_GROUND] += n_ground
    counts[_OBSTACLE] += n_obstacle
    counts[_OUTLIER] += n_outlier


@kernel
def _label_others(
    n_others: int,
    other_range_m: Float32,
    other_cell: NDArray[np.int32],
    range_m: Float32,
    dx_m: Float32,
    dy_m: Float32,
    z_m: Float32,
    heights_m: Float32,
    first: NDArray[np.int32],
    second: NDArray[np.int32],
    across: Float32,
    height_m: Float32,
    label: NDArray[np.uint8],
    counts: Int,
) -> None:
    """Returns that share a cell with a nearer one, or belong to no row: those have no neighbours to be judged by."""
    columns, cells = len(across), range_m.shape[1]
    for other in range(n_others):
        i, cell = cells + other, other_cell[other]
        c = cell % columns if cell >= 0 else -1 - cell
        dx, dy = dx_m[i], dy_m[i]
        distance_m = np.sqrt(dx * dx + dy * dy)
        height_m[i] = z_m[i] - profile_height(heights_m, first, second, across, c, distance_m)
        label[i] = _GROUND if abs(height_m[i]) <= _LEVEL_M else _OBSTACLE
        if cell >= 0 and not supported(range_m, columns, 2, cell // columns, c, other_range_m[other]):
            label[i] = _OUTLIER
        counts[label[i]] += 1
