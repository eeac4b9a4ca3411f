"""A scan with the class of every point: what every method returns, and the steps all of them share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.ground import Ground
from quadlog.lidar.points import PointClass, in_field_of_view, valid_points
from quadlog.messages import Float, Float32

Route = Literal["rings", "elevations", "height_map", "paper"]
"""By the driver's beam numbers, by beams the elevations show, by a map of the lowest points, or as the paper does."""
FEWEST_RETURNS = 20
"""Among fewer on the ground and on obstacles no filter tells a thing from a false point."""
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
    route: how the scan was looked at.
    """

    xyz_base_m: Float32
    label: NDArray[np.uint8]
    ground: Ground | None
    height_m: Float32
    route: Route
    _counts: NDArray[np.int64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # Once for all who ask: a table's row, the maps, the counts of the run.
        object.__setattr__(self, "_counts", np.bincount(self.label, minlength=len(PointClass)))

    @property
    def n_raw(self) -> int:
        """Points as they came."""
        return len(self.label)

    @property
    def n_valid(self) -> int:
        """Points that are finite, not (0, 0, 0) and in range, cropped ones included."""
        return self.n_raw - self._count(PointClass.INVALID)

    @property
    def n_outlier(self) -> int:
        """Points without neighbours."""
        return self._count(PointClass.OUTLIER)

    @property
    def n_ground(self) -> int:
        """Points on the ground."""
        return self._count(PointClass.GROUND)

    @property
    def n_obstacle(self) -> int:
        """Points that are left."""
        return self._count(PointClass.OBSTACLE)

    @property
    def shows_nothing(self) -> bool:
        """Whether a map would be wrong to say anything because of this scan: an empty one is no sight of free space."""
        return self.n_ground + self.n_obstacle < FEWEST_RETURNS

    def _count(self, wanted: PointClass) -> int:
        return int(self._counts[wanted])


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

    OBSTACLE is what a point is until a filter says otherwise: whatever no
    filter explains must end in the map.
    """
    valid = valid_points(xyz_lidar_m, min_range_m, max_range_m)
    xyz_base_m = _transformed(xyz_lidar_m, valid, np.asarray(transform_lidar_to_base, dtype=np.float64))
    label = np.full(len(xyz_lidar_m), PointClass.OBSTACLE, dtype=np.uint8)
    # An invalid point's azimuth is NaN and lies in no field of view: it is labelled last.
    label[~in_field_of_view(xyz_base_m, field_of_view_deg)] = PointClass.CROPPED
    label[~valid] = PointClass.INVALID
    return xyz_base_m, label


@njit(cache=True)
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
