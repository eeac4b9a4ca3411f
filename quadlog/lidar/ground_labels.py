"""Ground or obstacle: the ground's height around the lidar by sector and distance, and labels by height above it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import cached, inner, kernel
from quadlog.lidar.classified_scan import PointClass, level_plane
from quadlog.lidar.ground_columns import Walked, walk_columns
from quadlog.lidar.isolation_filter import Isolated, supported
from quadlog.lidar.range_image import Image
from quadlog.messages import Float, Float32

Marks = NDArray[np.int8]

SECTOR_COLUMNS = 16
"""About 3 degrees: at 10 m as wide as the ground may curve, and few enough returns to average."""
STEP_M, REACH_M = 0.125, 32.0
STEPS = int(REACH_M / STEP_M) + 1
_SECTORS_BESIDE, _FEWEST = 3, 3
_PLANE_COLUMNS = 4
_STEP, _PER_STEP = np.float32(STEP_M), np.float32(1 / STEP_M)


class Sectors(NamedTuple):
    """Every SECTOR_COLUMNS columns of an image make a sector.

    outward: (sectors, 2) their directions in the lidar's frame. first, second: (columns,) where the sectors on either
    side of each column begin in a profile; across: (columns,) how far it lies from the first one's middle to the
    second one's.
    """

    outward: Float
    first: NDArray[np.int32]
    second: NDArray[np.int32]
    across: Float32


@lru_cache(maxsize=4)
def _sectors(columns: int) -> Sectors:
    sectors = -(-columns // SECTOR_COLUMNS)
    azimuth_rad = (np.arange(sectors) + 0.5) * (SECTOR_COLUMNS / columns * 2 * np.pi)
    from_middle = np.arange(columns) - SECTOR_COLUMNS // 2
    sector = from_middle // SECTOR_COLUMNS
    return Sectors(
        outward=np.column_stack([np.cos(azimuth_rad), np.sin(azimuth_rad)]),
        first=(sector % sectors * STEPS).astype(np.int32),
        second=((sector + 1) % sectors * STEPS).astype(np.int32),
        across=((from_middle - sector * SECTOR_COLUMNS + 0.5) / SECTOR_COLUMNS).astype(np.float32),
    )


def label_beams(
    image: Image, seen: Isolated, descending: NDArray[np.bool_], floor_m: float, transform_lidar_to_level: Float
) -> Float:
    """Fill label and height_m of an image of beams; returns (3,) a, b, c of the plane z = a x + b y + c in base.

    descending: (rows,) as in `walk_columns`; floor_m: height of the ground under the lidar. The plane is that of every
    fourth of the ground's returns.
    """
    turn, lidar_m = transform_lidar_to_level[:2, :2].copy(), transform_lidar_to_level[:2, 3]
    walked, held = walk_columns(seen, image.range_m[0], descending, np.float32(floor_m)), image.held
    used, shape = walked.ground[:, ::_PLANE_COLUMNS] != 0, walked.ground.shape
    places = [each[: walked.ground.size].reshape(shape)[:, ::_PLANE_COLUMNS][used] for each in held[:3]]
    plane = level_plane(np.column_stack(places) + np.array([*lidar_m, 0.0]), 0.0)
    _label(image, seen, walked, floor_m, turn, _sectors(image.columns), plane)
    return plane


@kernel
def _label(
    image: Image, seen: Isolated, walked: Walked, floor_m: float, turn: Float, sectors: Sectors, plane: Float
) -> None:
    """turn: (2, 2) from the lidar's frame to base."""
    heights_m = _profile(walked.ground, seen, floor_m, sectors.outward, turn, plane).reshape(-1)
    _label_cells(image, seen, walked, heights_m, sectors)
    if image.n_others > 0:
        _label_others(image, heights_m, sectors)


# Sums of a sector's sixteen returns may be taken in any order.
@cached(error_model="numpy", fastmath={"reassoc"})
def _profile(ground: Marks, seen: Isolated, floor_m: float, outward: Float, turn: Float, plane: Float) -> Float32:
    """(sectors, STEPS) height of the ground in base, every STEP_M outwards.

    Straight lines from floor_m under the lidar through the mean of each beam's ground in the sector, borrowed from the
    sectors beside it where it has too little; beyond the last, plane goes on.
    """
    distance_m, z_m, sectors = seen.distance_m, seen.z_m, len(outward)
    rows, columns = ground.shape
    sums, height_m = np.empty((3, sectors, rows), np.float32), np.empty((sectors, STEPS), np.float32)
    none = np.float32(0)
    for row in range(rows):
        for s in range(sectors):
            begin = s * SECTOR_COLUMNS
            is_ground, distance, z = ground[row, begin:], distance_m[row, begin:], z_m[row, begin:]
            count, far, high = np.int32(0), none, none
            # A constant number of steps wherever possible, which the compiler turns into vector instructions.
            size = SECTOR_COLUMNS if begin + SECTOR_COLUMNS <= columns else columns - begin
            if size == SECTOR_COLUMNS:
                for c in range(SECTOR_COLUMNS):
                    count += np.int32(is_ground[c])
                    far += distance[c] if is_ground[c] != 0 else none
                    high += z[c] if is_ground[c] != 0 else none
            else:
                for c in range(size):
                    count += np.int32(is_ground[c])
                    far += distance[c] if is_ground[c] != 0 else none
                    high += z[c] if is_ground[c] != 0 else none
            sums[0, s, row], sums[1, s, row], sums[2, s, row] = count, far, high
    for s in range(sectors):
        at, step, z0, heights = none, 0, np.float32(floor_m), height_m[s]
        for row in range(rows):
            count_here, far, high = sums[0, s, row], sums[1, s, row], sums[2, s, row]
            for k in range(1, _SECTORS_BESIDE + 1):
                if count_here >= SECTOR_COLUMNS // 2:
                    break
                a = s - k if s >= k else s - k + sectors
                b = s + k if s + k < sectors else s + k - sectors
                count_here += sums[0, a, row] + sums[0, b, row]
                far += sums[1, a, row] + sums[1, b, row]
                high += sums[2, a, row] + sums[2, b, row]
            if count_here < _FEWEST or far / count_here <= at:
                continue
            far, high = far / count_here, high / count_here
            end = min(int(far * _PER_STEP) + 1, STEPS)
            _draw_line(heights[step:end], step, (high - z0) / (far - at), z0, at)
            step, at, z0 = max(end, step), far, high
        x = turn[0, 0] * outward[s, 0] + turn[0, 1] * outward[s, 1]
        y = turn[1, 0] * outward[s, 0] + turn[1, 1] * outward[s, 1]
        rise = (x * plane[0] + y * plane[1]) / np.sqrt(x * x + y * y)
        _draw_line(heights[step:], step, np.float32(rise), z0, at)
    return height_m


@inner
def _draw_line(height_m: Float32, step: int, rise: float, z_m: float, at_m: float) -> None:
    first_m = np.float32(step) * _STEP - at_m
    for k in range(len(height_m)):
        height_m[k] = z_m + rise * (first_m + np.float32(k) * _STEP)


@inner
def _profile_height(heights_m: Float32, sectors: Sectors, column: int, distance_m: float) -> float:
    """The ground's height at a distance in a column; heights_m: (sectors * STEPS,)."""
    first, second, across = sectors.first, sectors.second, sectors.across
    v = min(distance_m * _PER_STEP, np.float32(STEPS - 2))
    k = np.int32(v)
    along = v - np.float32(k)
    a, b = np.uint32(first[column] + k), np.uint32(second[column] + k)
    near = heights_m[a] + along * (heights_m[a + np.uint32(1)] - heights_m[a])
    far = heights_m[b] + along * (heights_m[b + np.uint32(1)] - heights_m[b])
    return near + across[column] * (far - near)


# Largest height of ground points: found by the column walk, not found by it, and at the foot of a wall.
_WALKED_M, _LEVEL_M, _FOOT_M, _SUNKEN_M = np.float32(0.10), np.float32(0.04), np.float32(0.01), np.float32(-0.3)
_INVALID, _, _OUTLIER, _GROUND, _OBSTACLE = (np.uint8(each) for each in PointClass)


def label_supported(image: Image, seen: Isolated) -> None:
    """Label every return an obstacle where neighbours support it, else an outlier."""
    cells = image.rows * image.columns
    classes = np.where(seen.good.reshape(-1) != 0, _OBSTACLE, _OUTLIER)
    image.held.label[:cells] = np.where(image.range_m[0] > 0, classes, _INVALID)
    if image.n_others:
        _judge_others(image)


@kernel
def _judge_others(image: Image) -> None:
    cells = image.rows * image.columns
    for other in range(image.n_others):
        row, c = image.other_cell[other] // image.columns, image.other_cell[other] % image.columns
        real = supported(image, row, c, image.other_range_m[other])
        image.held.label[cells + other] = _OBSTACLE if real else _OUTLIER


@inner
def _label_cells(image: Image, seen: Isolated, walked: Walked, heights_m: Float32, sectors: Sectors) -> None:
    """The nearest return of every cell: INVALID where there is none, OUTLIER where it is not supported."""
    good, ground, wall, distance_m, z_m = seen.good, walked.ground, walked.wall, seen.distance_m, seen.z_m
    height_m, label, range_m = image.held.height_m, image.held.label, image.range_m[0]
    rows, columns = good.shape
    none = np.float32(0)
    for row in range(rows):
        begin = row * columns
        distance, z, is_good, is_ground, is_wall = distance_m[row], z_m[row], good[row], ground[row], wall[row]
        # An index the compiler cannot see to be positive would keep the loops from becoming vector instructions.
        above_m, classes, ranges_m = height_m[begin:], label[begin:], range_m[begin:]
        for c in range(columns):
            above_m[c] = z[c] - _profile_height(heights_m, sectors, c, distance[c])
        for c in range(columns):
            above = above_m[c]
            near = _FOOT_M if is_wall[c] != 0 else (_WALKED_M if is_ground[c] != 0 else _LEVEL_M)
            sunken = (is_ground[c] != 0) & (above < none) & (above > _SUNKEN_M)
            surface = _GROUND if (abs(above) <= near) | sunken else _OBSTACLE
            alone = _OUTLIER if ranges_m[c] > none else _INVALID
            classes[c] = surface if is_good[c] != 0 else alone


@inner
def _label_others(image: Image, heights_m: Float32, sectors: Sectors) -> None:
    """Returns that share a cell with a nearer one, or belong to no row: those have no neighbours to be judged by."""
    dx_m, dy_m, height_m, label = image.held.dx_m, image.held.dy_m, image.held.height_m, image.held.label
    columns, cells = image.columns, image.rows * image.columns
    for other in range(image.n_others):
        i, cell = cells + other, image.other_cell[other]
        c = cell % columns if cell >= 0 else -1 - cell
        dx, dy = dx_m[i], dy_m[i]
        distance_m = np.sqrt(dx * dx + dy * dy)
        height_m[i] = image.held.z_m[i] - _profile_height(heights_m, sectors, c, distance_m)
        label[i] = _GROUND if abs(height_m[i]) <= _LEVEL_M else _OBSTACLE
        if cell >= 0 and not supported(image, cell // columns, c, image.other_range_m[other]):
            label[i] = _OUTLIER
