"""Scans of spinning lidars: organised into a range image, false points by isolation, ground by walking columns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classified_scan import (
    FLATTEST_CLOUD,
    MOUNT_KNOWN_M,
    ClassifiedScan,
    PointClass,
    Route,
    height_without_ground,
)
from quadlog.lidar.ground_columns import ColumnWalk
from quadlog.lidar.ground_labels import GroundProfile, crop_to_view, label_returns, label_supported, level_plane
from quadlog.lidar.height_map import grow_ground
from quadlog.lidar.isolation_filter import Isolated
from quadlog.lidar.range_image import (
    Beams,
    Image,
    beams_by_bins,
    beams_by_elevation,
    beams_by_ring,
    phase_and_strangers,
    to_polar,
)
from quadlog.lidar.ransac_plane import GroundPlane
from quadlog.messages import Float, Float32, Int

FEWEST_BEAMS = 3
"""With fewer beams, slopes between beams cannot separate ground from walls: everything is an obstacle."""
MOST_TILT_COSINE = 0.7
"""A lidar tilted by more than 45 degrees has no columns that lead outwards over the ground."""
NEAR_FLOOR_M = 5.0
SCANS_BETWEEN_LOOKS = 50
"""The beams are searched for again at least this often."""
# So many more points, as a share of the scan's, without a cell or a beam of their own than when the beams were found
# mean that the sensor or its driver has changed.
_CHANGED_SHARE = 0.03

XyzM = tuple[Float32, Float32, Float32]
Laid = tuple[XyzM, NDArray[np.uint16], NDArray[np.uint8], Beams, Float32, tuple[float, float], float]
"""Arguments of `Image.lay`."""


@dataclass(frozen=True, slots=True)
class RangeImageSettings:
    """Parameters of this method, as the configuration's sections `lidar` and `ground` explain them."""

    min_range_m: float = 0.3
    max_range_m: float = 30.0
    field_of_view_deg: float = 360.0
    ground_min_points: int = 100

    @property
    def ranges_m(self) -> tuple[float, float]:
        """The least and the most range that count."""
        return float(self.min_range_m), float(self.max_range_m)


@dataclass(slots=True)
class _Known:
    """The sensor's beams, and the shares of points without a cell or a beam in the scan in which they were found."""

    beams: Beams
    route: Route
    upright: bool
    n_points: int
    has_rings: bool
    scans_left: int = SCANS_BETWEEN_LOOKS
    others_share: float = 0.0
    without_row_share: float = 0.0


@dataclass(frozen=True, slots=True)
class _Space:
    """Work arrays for images of one shape."""

    image: Image
    isolated: Isolated
    walk: ColumnWalk
    profile: GroundProfile

    @classmethod
    def of(cls, beams: Beams, room: int) -> _Space:
        shape = beams.rows, beams.columns
        return cls(Image(*shape, room), Isolated(*shape), ColumnWalk(*shape), GroundProfile(*shape))


@dataclass(frozen=True, slots=True)
class ImageClasses:
    """A classified image: counts (5,) of the points by PointClass, the ground's plane without inliers, or None.

    The places in the image are along the axes of base made upright. `point_numbers` has the point of each cell.
    """

    image: Image
    counts: Int
    ground: GroundPlane | None
    route: Route
    laid: Laid

    def point_numbers(self) -> NDArray[np.int32]:
        """(rows * columns + n_others,) number of the point in every cell, -1 for none, and of every other return."""
        image = self.image
        point = np.full(image.rows * image.columns + image.room, -1, np.int32)
        Image(image.rows, image.columns, image.room).lay(*self.laid, point)
        return point[: image.rows * image.columns + image.n_others]


class RangeImageClassifier:
    """Classifies the scans of one lidar, one after the other, in arrays that are kept from scan to scan.

    The beams are found in the first scan and looked for again when a scan contradicts them, and every
    SCANS_BETWEEN_LOOKS scans.
    """

    def __init__(self, settings: RangeImageSettings) -> None:
        self._settings = settings
        self._known: _Known | None = None
        self._space: _Space | None = None
        self._no_key = np.zeros(0, np.uint16)

    def classify(
        self, xyz_m: XyzM, ring: NDArray[np.uint16] | None, slot: NDArray[np.uint8], transforms: Float
    ) -> ImageClasses:
        """The class of every point x, y, z (N,) in the lidar's frame; any values are accepted.

        ring: (N,) beam numbers in any order, or None; numbers that contradict the elevations are ignored. slot: (N,)
        time slots. transforms: (2, 4, 4) to base made upright, and its change per slot. The whole scan is classified
        and then cropped to the field of view: points outside it help to judge those inside.
        """
        transform = transforms[0]
        counts = np.zeros(len(PointClass), np.int64)
        laid = None
        if abs(float(transform[2, 2])) >= MOST_TILT_COSINE:
            laid = self._lay_beams(xyz_m, ring, slot, transforms)
        space, route, arguments = laid or self._lay_bins(xyz_m, slot, transform)
        plane = self._label(space, arguments[3], route, transform, counts)
        counts[PointClass.INVALID] = len(xyz_m[0]) - space.image.n_valid
        if self._settings.field_of_view_deg < 360:
            crop_to_view(space.image, transform[:2, 3], self._settings.field_of_view_deg, counts)
        enough = counts[PointClass.GROUND] >= self._settings.ground_min_points
        return ImageClasses(space.image, counts, _as_ground(plane) if enough else None, route, arguments)

    def _lay_beams(
        self, xyz_m: XyzM, ring: NDArray[np.uint16] | None, slot: NDArray[np.uint8], transforms: Float
    ) -> tuple[_Space, Route, Laid] | None:
        """The scan in an image of its beams; None where it shows none."""
        known, upright, n = self._known, bool(transforms[0, 2, 2] > 0), len(xyz_m[0])
        scan = xyz_m, self._no_key if ring is None else ring, slot, _turning(transforms)
        alike = known is not None and (known.upright, known.has_rings) == (upright, ring is not None)
        if known is not None and alike and known.scans_left > 0 and abs(n - known.n_points) <= known.n_points // 4:
            known.scans_left -= 1
            most = known.without_row_share + _CHANGED_SHARE, known.others_share + _CHANGED_SHARE
            if (found := self._lay_on(known.beams, *scan, *most)) is not None:
                return found[0], known.route, found[1]
        self._known = None
        polar = to_polar(xyz_m, self._settings.ranges_m)
        route: Route = "rings"
        beams = beams_by_ring(polar, ring, upright)
        if beams is None:
            route, beams = "elevations", beams_by_elevation(polar, upright)
        if beams is None or (found := self._lay_on(beams, *scan)) is None:
            return None
        self._known = _Known(beams, route, upright, n, ring is not None, SCANS_BETWEEN_LOOKS, *found[2:])
        return found[0], route, found[1]

    def _lay_on(
        self,
        beams: Beams,
        xyz_m: XyzM,
        key: NDArray[np.uint16],
        slot: NDArray[np.uint8],
        turning: Float32,
        most_strangers: float = math.inf,
        most_others: float = math.inf,
    ) -> tuple[_Space, Laid, float, float] | None:
        """The image, the arguments of its `lay`, and the shares of points without a cell or a beam of their own.

        None where one of the shares is larger than allowed.
        """
        phase, strangers = phase_and_strangers(xyz_m, key, beams, self._settings.ranges_m)
        if strangers > most_strangers:
            return None
        space = self._space_for(beams, len(xyz_m[0]))
        laid = xyz_m, key, slot, beams, turning, self._settings.ranges_m, phase
        space.image.lay(*laid)
        others = space.image.n_others / max(len(xyz_m[0]), 1)
        return None if others > most_others else (space, laid, others, strangers)

    def _lay_bins(self, xyz_m: XyzM, slot: NDArray[np.uint8], transform: Float) -> tuple[_Space, Route, Laid]:
        """The scan in an image by directions along base's axes from the lidar's place."""
        turn = transform[:3, :3].astype(np.float32)
        with np.errstate(all="ignore"):
            turned: XyzM = tuple(row[0] * xyz_m[0] + row[1] * xyz_m[1] + row[2] * xyz_m[2] for row in turn)  # type: ignore[assignment]
        polar = to_polar(turned, self._settings.ranges_m)
        beams, key = beams_by_bins(polar.range_m, polar.sine)
        unturned = np.zeros((2, 4, 4))
        unturned[0] = np.eye(4)
        unturned[0, 2, 3] = transform[2, 3]
        space = _Space.of(beams, len(key))
        laid = turned, key, slot, beams, _turning(unturned), self._settings.ranges_m, 0.0
        space.image.lay(*laid)
        return space, "height_map", laid

    def _space_for(self, beams: Beams, room: int) -> _Space:
        space = self._space
        if space is None or (space.image.rows, space.image.columns) != (beams.rows, beams.columns):
            space = None
        if space is None or space.image.room < room:
            space = self._space = _Space.of(beams, room + room // 8)
        return space

    def _label(self, space: _Space, beams: Beams, route: Route, transform: Float, counts: Int) -> Float:
        """Label the image, and the plane (3,) z = a x + b y + c through the ground, in base."""
        image, lidar_z_m = space.image, float(transform[2, 3])
        space.isolated.isolate(image, lidar_z_m)
        if route == "height_map":
            return _label_bins(space, transform, counts)
        if beams.rows < FEWEST_BEAMS:
            return _all_obstacles(space, lidar_z_m, counts)
        isolated, walk, profile = space.isolated, space.walk, space.profile
        floor_m = 0.0 if lidar_z_m > MOUNT_KNOWN_M else _floor_below(isolated, beams.descending, lidar_z_m)
        smoothed = isolated.distance_m, isolated.z_m
        walk.walk(isolated.good, *smoothed, image.range_m[0], beams.descending, floor_m)
        plane = level_plane(walk.ground, image.dx_m, image.dy_m, image.z_m, transform[:2, 3])
        profile.fit(walk.ground, *smoothed, floor_m, plane, transform)
        label_returns(image, isolated, walk, profile, counts)
        return plane


def _turning(transforms: Float) -> Float32:
    """(2, 3, 4) float32 as `Image.lay` takes it."""
    turning: Float32 = transforms[:, :3].astype(np.float32)
    return turning


def _as_ground(plane: Float) -> GroundPlane:
    size = float(np.sqrt(plane[0] ** 2 + plane[1] ** 2 + 1.0))
    return GroundPlane(np.array([-plane[0], -plane[1], 1.0]) / size, -float(plane[2]) / size, np.zeros(0, np.bool_))


def _label_bins(space: _Space, transform: Float, counts: Int) -> Float:
    image, lidar_z_m = space.image, float(transform[2, 3])
    n = image.rows * image.columns
    seen = np.concatenate([image.range_m[0] > 0, np.ones(image.n_others, np.bool_)])
    range_m = np.concatenate([image.range_m[0], image.other_range_m[: image.n_others]])[seen]
    z_m = image.z_m[: n + image.n_others][seen]
    sine = (z_m - np.float32(lidar_z_m)) / range_m
    if len(sine) == 0 or np.ptp(sine) < FLATTEST_CLOUD:
        return _all_obstacles(space, lidar_z_m, counts)
    floor_m = 0.0
    if lidar_z_m <= MOUNT_KNOWN_M:
        # The lowest twentieth of the near points is taken for the floor.
        near_z_m = z_m[range_m < NEAR_FLOOR_M]
        floor_m = float(np.quantile(near_z_m, 0.05)) if len(near_z_m) else lidar_z_m
    label_supported(image, space.isolated, counts)
    a, b, c = grow_ground(image, floor_m, counts)
    return np.array([a, b, c - a * transform[0, 3] - b * transform[1, 3]])


def _all_obstacles(space: _Space, lidar_z_m: float, counts: Int) -> Float:
    """Whatever neighbours support, at its height above base's floor."""
    label_supported(space.image, space.isolated, counts)
    space.image.height_m[:] = height_without_ground(space.image.z_m, lidar_z_m)
    return np.zeros(3)


def _floor_below(isolated: Isolated, descending: NDArray[np.bool_], lidar_z_m: float) -> float:
    """Median height of the lowest beam with enough returns."""
    for row in np.flatnonzero(descending):
        seen = isolated.z_m[row][isolated.good[row] != 0]
        if len(seen) >= isolated.good.shape[1] // 20:
            return float(np.median(seen))
    return lidar_z_m


def classify_scan_range_image(
    xyz_lidar_m: Float,
    ring: NDArray[np.uint16] | None,
    transform_lidar_to_base: Float,
    settings: RangeImageSettings,
) -> ClassifiedScan:
    """The class of every point of a single scan (N, 3) in the lidar's frame; see `RangeImageClassifier`."""
    from quadlog.lidar.scan_classifier import ScanClassifier
    from quadlog.messages import PointCloud

    cloud = PointCloud(None, "", np.asarray(xyz_lidar_m), ring)
    return ScanClassifier(settings).classify(cloud, transform_lidar_to_base).points()
