"""A scan whose points are classified, and what its classes and its ground are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Float32, Int


class PointClass(IntEnum):
    """The class of one point, stored as uint8 (`cloud_samples.npz`)."""

    INVALID = 0
    CROPPED = 1
    OUTLIER = 2
    GROUND = 3
    OBSTACLE = 4


Route = Literal["rings", "elevations", "height_map", "paper", "several"]
"""Method used: the driver's ring numbers, beams found in the elevations, a map of lowest points, the paper's, or each
scanner's own.
"""
FEWEST_RETURNS = 20
"""With fewer ground and obstacle points a scan is not used for maps."""
FLATTEST_CLOUD = 0.05
"""In sines of elevation; a cloud that spans less is a scan in a plane."""
MOUNT_KNOWN_M = 0.1
"""A lidar lower above base's floor cannot be mounted there: its mount is unknown, and the floor is looked for."""
STEEPEST_GROUND_DEG = 45.0
"""A steeper plane is a wall that was taken for the ground: no heights are measured from it."""


class GroundPlane(NamedTuple):
    """The plane normal . p + d_m = 0 of base, with a unit normal (3,) that points up."""

    normal: Float
    d_m: float

    @property
    def is_level(self) -> bool:
        """Whether a robot could stand on it."""
        return bool(self.normal[2] >= math.cos(math.radians(STEEPEST_GROUND_DEG)))

    def height_m(self, xyz_base_m: Float) -> Float:
        """Vertical height (N,) of points (N, 3) above the plane."""
        height_m: Float = (xyz_base_m @ self.normal + self.d_m) / self.normal[2]
        return height_m


def level_plane(xyz_m: Float, floor_m: float) -> Float:
    """(3,) a, b, c of the plane z = a x + b y + c nearest in height to points (N, 3).

    A slight pull towards level at floor_m keeps it defined when there are few points or all in a line.
    """
    sides = xyz_m.copy()
    sides[:, 2] = 1.0
    normal, height_m = sides.T @ sides, sides.T @ xyz_m[:, 2]
    normal.flat[::4] += _PULL
    height_m[2] += _PULL[2] * floor_m
    plane: Float = np.linalg.solve(normal, height_m)
    return plane


_PULL = np.array([1.0, 1.0, 1e-3])


class Returns(NamedTuple):
    """Points of a scan along the axes of base made upright, in the order of its message, (N,) each.

    dx_m, dy_m: from below the lidar; z_m: in base; height_m: above the ground; label: of PointClass; slot: of time.
    Places and heights of INVALID points mean nothing.
    """

    dx_m: Float32
    dy_m: Float32
    z_m: Float32
    height_m: Float32
    label: NDArray[np.uint8]
    slot: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class ClassifiedScan:
    """The points of one scan as they were measured: nothing is deskewed.

    counts: (5,) points of each class. columns: steps of a full turn in which its beams measure, 0 where none are known.
    ground: None where none was found. lidar_base_m: (3,) where the lidar stands, z above the ground. slot_ns: (K,)
    middles of the time slots after the stamp.
    """

    returns: Returns
    counts: Int
    columns: int
    ground: GroundPlane | None
    route: Route
    lidar_base_m: Float
    slot_ns: Int

    @property
    def shows_nothing(self) -> bool:
        """Whether the scan has too few returns to update a map: an empty scan does not show free space."""
        return bool(self.counts[PointClass.GROUND] + self.counts[PointClass.OBSTACLE] < FEWEST_RETURNS)

    @property
    def xyz_base_m(self) -> Float32:
        """All points (N, 3) in base."""
        x_m, y_m = self.lidar_base_m[:2].astype(np.float32)
        return np.column_stack([self.returns.dx_m + x_m, self.returns.dy_m + y_m, self.returns.z_m])


def merged(scans: Sequence[ClassifiedScan], late_ns: Sequence[int]) -> ClassifiedScan:
    """Scans of several scanners as one of the first, with its place and the first ground; late_ns: of each stamp.

    A lone scan is itself.
    """
    if len(scans) == 1:
        return scans[0]
    first, slots, returns = scans[0], 0, list[Returns]()
    for scan in scans:
        off_m, own = (scan.lidar_base_m - first.lidar_base_m).astype(np.float32), scan.returns
        slot = own.slot + np.uint8(slots)
        returns.append(own._replace(dx_m=own.dx_m + off_m[0], dy_m=own.dy_m + off_m[1], slot=slot))
        slots += len(scan.slot_ns)
    return ClassifiedScan(
        returns=Returns(*map(np.concatenate, zip(*returns, strict=True))),
        counts=np.sum([scan.counts for scan in scans], axis=0),
        columns=0,
        ground=next((scan.ground for scan in scans if scan.ground is not None), None),
        route="several",
        lidar_base_m=first.lidar_base_m,
        slot_ns=np.concatenate([scan.slot_ns + late for scan, late in zip(scans, late_ns, strict=True)]),
    )


def class_counts(label: NDArray[np.uint8]) -> Int:
    """(5,) points of each class."""
    return np.array([np.count_nonzero(label == kind) for kind in range(len(PointClass))])


def lidar_above(ground: GroundPlane | None, transform_lidar_to_base: Float) -> Float:
    """Where the lidar stands (3,): x and y in base, and its height above the ground's plane where that is level."""
    place_m: Float = transform_lidar_to_base[:3, 3].copy()
    if ground is not None and ground.is_level:
        place_m[2] = ground.height_m(place_m)
    return place_m


def height_without_ground(z_base_m: Float32, lidar_z_m: float) -> Float32:
    """Heights (N,) of points at z_base_m (N,) where a scan in a plane shows no ground: those above z = 0 of base.

    A lidar whose mount is unknown stands at least MOUNT_KNOWN_M high: else
    all it sees would lie on the floor, and no wall would block.
    """
    height_m: Float32 = z_base_m if lidar_z_m > MOUNT_KNOWN_M else z_base_m + np.float32(MOUNT_KNOWN_M - lidar_z_m)
    return height_m


def outside_view(x_m: Float, y_m: Float, field_of_view_deg: float) -> NDArray[np.bool_]:
    """Which of the points x, y (N,) of base lie outside a fan of field_of_view_deg about its x axis. [Following]"""
    if field_of_view_deg >= 360:
        return np.zeros(len(x_m), dtype=np.bool_)
    half_rad = np.deg2rad(field_of_view_deg) / 2
    # |azimuth| <= half  <=>  sin(half - |azimuth|) >= 0, multiplied by the range: no arctan for every point.
    inside: NDArray[np.bool_] = np.sin(half_rad) * x_m >= np.cos(half_rad) * np.abs(y_m)
    return ~inside
