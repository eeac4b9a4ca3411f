"""Point classes, valid ranges and field of view, and scans whose points are classified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import cached
from quadlog.lidar.deskew import Slots
from quadlog.lidar.ransac_plane import GroundPlane
from quadlog.messages import Float, Float32, Int


class PointClass(IntEnum):
    """The class of one point, stored as uint8 (`cloud_samples.npz`)."""

    INVALID = 0
    CROPPED = 1
    OUTLIER = 2
    GROUND = 3
    OBSTACLE = 4


def valid_points(xyz_m: Float, min_range_m: float, max_range_m: float) -> NDArray[np.bool_]:
    """Mask (N,) of the points (N, 3), in the lidar's frame, that are valid returns.

    Drivers write "no return" as NaN, infinity, (0, 0, 0) or a huge number. One of these left in disables the
    statistical filter or pulls the ground plane through the sensor, so all go before anything is computed.
    """
    return _valid_points(xyz_m, float(min_range_m), float(max_range_m))


@cached()
def _valid_points(xyz_m: Float, min_range_m: float, max_range_m: float) -> NDArray[np.bool_]:
    # In float64 the square of the largest float32 is still finite, and NaN
    # fails both comparisons: one pass, no overflow, no warnings.
    least, most = min_range_m * min_range_m, max_range_m * max_range_m
    valid = np.empty(len(xyz_m), dtype=np.bool_)
    for i in range(len(xyz_m)):
        x, y, z = np.float64(xyz_m[i, 0]), np.float64(xyz_m[i, 1]), np.float64(xyz_m[i, 2])
        squared = x * x + y * y + z * z
        valid[i] = squared > 0.0 and squared >= least and squared <= most
    return valid


def in_field_of_view(x_m: Float, y_m: Float, field_of_view_deg: float) -> NDArray[np.bool_]:
    """Which of the points x, y (N,) of base lie within a fan of field_of_view_deg about its x axis. [Following]"""
    if field_of_view_deg >= 360:
        return np.ones(len(x_m), dtype=np.bool_)
    half_rad = np.deg2rad(field_of_view_deg) / 2
    # |azimuth| <= half  <=>  sin(half - |azimuth|) >= 0, multiplied by the range: no arctan for every point.
    inside: NDArray[np.bool_] = np.sin(half_rad) * x_m >= np.cos(half_rad) * np.abs(y_m)
    return inside


Route = Literal["rings", "elevations", "height_map", "paper"]
"""Method used: the driver's ring numbers, beams found in the elevations, a map of lowest points, or the paper's."""
FEWEST_RETURNS = 20
"""With fewer ground and obstacle points a scan is not used for maps."""
FLATTEST_CLOUD = 0.05
"""In sines of elevation; a cloud that spans less is a scan in a plane."""
MOUNT_KNOWN_M = 0.1
"""A lidar lower above base's floor cannot be mounted there: its mount is unknown, and the floor is looked for."""


@dataclass(frozen=True, slots=True)
class ClassifiedScan:
    """Every point of a scan in base, with its class.

    xyz_base_m: (N, 3) float32, NaN where the point is invalid.
    label: (N,) uint8 of PointClass.
    ground: the plane found, its inliers counted over all N points, or None.
    height_m: (N,) float32 height above the ground at each point's place, NaN where the point is invalid.
    route: the method used.
    """

    xyz_base_m: Float32
    label: NDArray[np.uint8]
    ground: GroundPlane | None
    height_m: Float32
    route: Route


def height_without_ground(z_base_m: Float32, lidar_z_m: float) -> Float32:
    """Heights (N,) of points at z_base_m (N,) where a scan in a plane shows no ground: those above base's own floor.

    A lidar whose mount is unknown stands at least MOUNT_KNOWN_M high: else
    all it sees would lie on the floor, and no wall would block.
    """
    height_m: Float32 = z_base_m if lidar_z_m > MOUNT_KNOWN_M else z_base_m + np.float32(MOUNT_KNOWN_M - lidar_z_m)
    return height_m


def cropped_to_base(
    xyz_lidar_m: Float,
    transform_lidar_to_base: Float,
    min_range_m: float,
    max_range_m: float,
    field_of_view_deg: float,
) -> tuple[Float, NDArray[np.uint8]]:
    """Points (N, 3) moved to base, NaN where invalid, and (N,) labels INVALID, CROPPED, or OBSTACLE for the rest.

    OBSTACLE is what a point is until a filter says otherwise: whatever no filter explains must end in the map.
    """
    valid = valid_points(xyz_lidar_m, min_range_m, max_range_m)
    xyz_base_m = _transformed(xyz_lidar_m, valid, np.asarray(transform_lidar_to_base, dtype=np.float64))
    label = np.full(len(xyz_lidar_m), PointClass.OBSTACLE, dtype=np.uint8)
    # An invalid point's azimuth is NaN and lies in no field of view: it is labelled last.
    label[~in_field_of_view(xyz_base_m[:, 0], xyz_base_m[:, 1], field_of_view_deg)] = PointClass.CROPPED
    label[~valid] = PointClass.INVALID
    return xyz_base_m, label


@cached()
def _transformed(xyz_m: Float, wanted: NDArray[np.bool_], transform: Float) -> Float:
    # Compiled, because picking rows out, moving them and putting them back costs ten times as much in numpy.
    moved = np.full((len(xyz_m), 3), np.nan)
    for i in range(len(xyz_m)):
        if wanted[i]:
            for row in range(3):
                moved[i, row] = (
                    transform[row, 0] * xyz_m[i, 0]
                    + transform[row, 1] * xyz_m[i, 1]
                    + transform[row, 2] * xyz_m[i, 2]
                    + transform[row, 3]
                )
    return moved


@dataclass(frozen=True, slots=True)
class ClassifiedReturns:
    """The returns of one scan along the axes of base made upright, as they were measured: nothing is deskewed.

    dx_m, dy_m (from the lidar), z_m (in base), height_m (above the ground), label (of PointClass), slot (of time): (M,)
    each. The first rows * columns of them are cells of a range image, row by row, INVALID where nothing returned; the
    others, or all where columns is 0, are in no order. The next scan of the same classifier overwrites them.
    counts: (5,) points of the message by PointClass. ground: the plane, without its inliers, or None. lidar_base_m:
    (3,) where the lidar stands, z above the ground. slots: when the time slots are. points: makes a ClassifiedScan of
    every point of the message, in its order, which costs more than classifying; not after the next scan.
    """

    dx_m: Float32
    dy_m: Float32
    z_m: Float32
    height_m: Float32
    label: NDArray[np.uint8]
    slot: NDArray[np.uint8]
    rows: int
    columns: int
    counts: Int
    ground: GroundPlane | None
    route: Route
    lidar_base_m: Float
    slots: Slots
    points: Callable[[], ClassifiedScan]

    @classmethod
    def of_points(cls, scan: ClassifiedScan, lidar_base_m: Float, slot: NDArray[np.uint8], slots: Slots) -> Self:
        """The points (N, 3) of a scan that no image holds; slot: (N,)."""
        x_m, y_m, z_m = np.ascontiguousarray(scan.xyz_base_m.T)
        dx_m, dy_m = x_m - np.float32(lidar_base_m[0]), y_m - np.float32(lidar_base_m[1])
        arrays = dx_m, dy_m, z_m, scan.height_m, scan.label, slot
        counts = np.bincount(scan.label, minlength=len(PointClass))
        return cls(*arrays, 0, 0, counts, scan.ground, scan.route, lidar_base_m, slots, lambda: scan)

    @property
    def n_raw(self) -> int:
        """Points of the message."""
        return int(self.counts.sum())

    @property
    def n_valid(self) -> int:
        """Points that are finite, not (0, 0, 0) and in range, cropped ones included."""
        return self.n_raw - int(self.counts[PointClass.INVALID])

    @property
    def n_outlier(self) -> int:
        """Outlier points."""
        return int(self.counts[PointClass.OUTLIER])

    @property
    def n_ground(self) -> int:
        """Ground points."""
        return int(self.counts[PointClass.GROUND])

    @property
    def n_obstacle(self) -> int:
        """Obstacle points."""
        return int(self.counts[PointClass.OBSTACLE])

    @property
    def shows_nothing(self) -> bool:
        """Whether the scan has too few returns to update a map: an empty scan does not show free space."""
        return self.n_ground + self.n_obstacle < FEWEST_RETURNS
