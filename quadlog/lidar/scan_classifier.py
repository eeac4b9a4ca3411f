"""Classify the scans of one lidar: spinning ones as range images, others on a map of lowest points, or as the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classified_scan import (
    FLATTEST_CLOUD,
    MOUNT_KNOWN_M,
    ClassifiedScan,
    GroundPlane,
    PointClass,
    Route,
    height_without_ground,
    lidar_above,
    outside_view,
)
from quadlog.lidar.deskew import sweep_slots
from quadlog.lidar.ground_labels import label_beams, label_supported
from quadlog.lidar.height_map import grow_ground
from quadlog.lidar.isolation_filter import Isolated, isolate
from quadlog.lidar.paper_method import PaperSettings, classify_as_paper
from quadlog.lidar.range_image import (
    Beams,
    Image,
    XyzM,
    beams_by_bins,
    beams_by_elevation,
    beams_by_number,
    lay,
    phase_and_strangers,
    to_polar,
)
from quadlog.messages import Float, PointCloud

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


@dataclass(frozen=True, slots=True)
class RangeImageSettings:
    """Parameters of range images and lowest points, as the sections `lidar` and `ground` explain them."""

    min_range_m: float = 0.3
    max_range_m: float = 30.0
    field_of_view_deg: float = 360.0
    ground_min_points: int = 100


class _Scan(NamedTuple):
    """A message as it is laid into an image: places in the lidar's frame, ring or None, time slot of each point (N,).

    transforms: (2, 4, 4) to base made upright, and its change per slot.
    """

    xyz_m: XyzM
    ring: NDArray[np.uint16] | None
    slot: NDArray[np.uint8]
    transforms: Float


@dataclass(slots=True)
class _Known:
    """The sensor's beams, and what was seen in the scan in which they were found.

    sensor: whether it stands upright, and has rings. strangers, others: shares of its points off their beams, and
    without a cell of their own.
    """

    beams: Beams
    route: Route
    sensor: tuple[bool, bool]
    n_points: int
    strangers: float
    others: float
    scans_left: int = SCANS_BETWEEN_LOOKS


class ScanClassifier:
    """Classifies the scans of one lidar, one after the other, in an image that is kept from scan to scan.

    The beams are found in the first scan and looked for again when a scan contradicts them, and every
    SCANS_BETWEEN_LOOKS scans. uses_times: whether the points' own times count; without them all of a scan is in one
    time slot.
    """

    def __init__(self, settings: RangeImageSettings | PaperSettings, seed: int = 0, *, uses_times: bool = True) -> None:
        self._settings, self._seed, self._uses_times = settings, seed, uses_times
        self._ranges_m = float(settings.min_range_m), float(settings.max_range_m)
        self._known: _Known | None = None
        self._image: Image | None = None

    def classify(self, cloud: PointCloud, transform_lidar_to_level: Float) -> ClassifiedScan:
        """The classified returns of a cloud, any values accepted; they are overwritten by the next one.

        transform_lidar_to_level: (4, 4) to base made upright, or (2, 4, 4) at the first and the last point's time.
        Ring numbers that contradict the elevations are ignored. The whole scan is classified and then cropped to the
        field of view: points outside it help to judge those inside.
        """
        transforms, settings, n = transform_lidar_to_level.reshape(-1, 4, 4), self._settings, len(cloud.xyz_m)
        slot = np.empty(n, np.uint8)
        slots = sweep_slots(cloud.times if self._uses_times else None, slot)
        if isinstance(settings, PaperSettings):
            mean = transforms.mean(axis=0)
            return classify_as_paper(cloud.xyz_m, slot, slots, mean, settings, self._seed)
        moving = np.empty((2, 4, 4))
        moving[0], moving[1] = transforms[0], (transforms[-1] - transforms[0]) / max(len(slots.middle_ns) - 1, 1)
        # Heights are measured, and the plane lies, about where the lidar is on average.
        moving[0, :3, 3], moving[1, :3, 3] = (transforms[0, :3, 3] + transforms[-1, :3, 3]) / 2, 0.0
        with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinity, which is no return
            x_m, y_m, z_m = np.array(cloud.xyz_m.T, np.float32, order="C")
        rings = cloud.ring is not None and len(cloud.ring) == n
        ring = np.array(cloud.ring, np.uint16) if rings else None
        scan, transform = _Scan((x_m, y_m, z_m), ring, slot, moving), moving[0]
        laid = self._lay_beams(scan) if abs(float(transform[2, 2])) >= MOST_TILT_COSINE else None
        image, beams, route = laid or self._lay_bins(scan)
        plane = _label_bins(image, transform) if route == "height_map" else _label_beams(image, beams, transform)
        found = image.filled
        if settings.field_of_view_deg < 360:
            x_m, y_m = found.dx_m + np.float32(transform[0, 3]), found.dy_m + np.float32(transform[1, 3])
            outside = outside_view(x_m, y_m, settings.field_of_view_deg)
            found.label[outside & (found.label != PointClass.INVALID)] = PointClass.CROPPED
        enough = np.count_nonzero(found.label == PointClass.GROUND) >= settings.ground_min_points
        ground = _as_ground(plane) if enough else None
        place_m = lidar_above(ground, transform)
        return ClassifiedScan(found, image.rows, image.columns, n, ground, route, place_m, slots)

    def _lay_beams(self, scan: _Scan) -> tuple[Image, Beams, Route] | None:
        """The scan in an image of its beams; None where it shows none."""
        known, n, upright = self._known, len(scan.slot), bool(scan.transforms[0, 2, 2] > 0)
        sensor = upright, scan.ring is not None
        if known is not None and known.sensor == sensor and abs(n - known.n_points) <= known.n_points // 4:
            known.scans_left -= 1
            if known.scans_left >= 0:
                image, strangers, others = self._lay_on(known.beams, scan)
                if strangers <= known.strangers + _CHANGED_SHARE and others <= known.others + _CHANGED_SHARE:
                    return image, known.beams, known.route
        self._known = None
        polar = to_polar(scan.xyz_m, self._ranges_m)
        route: Route = "rings"
        beams = None if scan.ring is None else beams_by_number(polar, scan.ring, upright)
        if beams is None:
            route, beams = "elevations", beams_by_elevation(polar, upright)
        if beams is None:
            return None
        image, strangers, others = self._lay_on(beams, scan)
        self._known = _Known(beams, route, sensor, n, strangers, others)
        return image, beams, route

    def _lay_on(self, beams: Beams, scan: _Scan) -> tuple[Image, float, float]:
        """The image, and the shares of points off their beams and without a cell of their own."""
        key = np.zeros(0, np.uint16) if scan.ring is None else scan.ring
        phase, strangers = phase_and_strangers(scan.xyz_m, key, beams, self._ranges_m)
        image, n = self._image, len(scan.slot)
        wanted = len(beams.descending), beams.columns
        if image is None or (image.rows, image.columns) != wanted or len(image.other_cell) < n:
            image = Image.empty(beams, n + n // 8)
        self._image = lay(image, scan.xyz_m, key, scan.slot, beams, scan.transforms, self._ranges_m, phase)
        return self._image, strangers, self._image.n_others / max(n, 1)

    def _lay_bins(self, scan: _Scan) -> tuple[Image, Beams, Route]:
        """The scan in an image by directions along base's axes from the lidar's place."""
        turn = scan.transforms[0, :3, :3].astype(np.float32)
        with np.errstate(all="ignore"):
            x_m, y_m, z_m = (row[0] * scan.xyz_m[0] + row[1] * scan.xyz_m[1] + row[2] * scan.xyz_m[2] for row in turn)
        polar = to_polar((x_m, y_m, z_m), self._ranges_m)
        beams, key = beams_by_bins(polar.range_m, polar.sine)
        unturned = np.zeros((2, 4, 4))
        unturned[0] = np.eye(4)
        unturned[0, 2, 3] = scan.transforms[0, 2, 3]
        places = (x_m, y_m, z_m), key, scan.slot
        image = lay(Image.empty(beams, len(key)), *places, beams, unturned, self._ranges_m, 0.0)
        return image, beams, "height_map"


def _label_beams(image: Image, beams: Beams, transform: Float) -> Float:
    """Label an image of beams, and the plane (3,) z = a x + b y + c through the ground, in base."""
    lidar_z_m = float(transform[2, 3])
    seen = isolate(image, np.float32(lidar_z_m))
    if image.rows < FEWEST_BEAMS:
        return _all_obstacles(image, seen, lidar_z_m)
    floor_m = 0.0 if lidar_z_m > MOUNT_KNOWN_M else _floor_below(seen, beams.descending, lidar_z_m)
    return label_beams(image, seen, beams.descending, floor_m, transform)


def _label_bins(image: Image, transform: Float) -> Float:
    """The same of an image of bins, on a map of lowest points."""
    lidar_z_m, found = float(transform[2, 3]), image.filled
    seen = isolate(image, np.float32(lidar_z_m))
    range_m = np.concatenate([image.range_m[0], image.other_range_m[: image.n_others]])
    range_m, z_m = range_m[range_m > 0], found.z_m[range_m > 0]
    sine = (z_m - np.float32(lidar_z_m)) / range_m
    if len(sine) == 0 or np.ptp(sine) < FLATTEST_CLOUD:
        return _all_obstacles(image, seen, lidar_z_m)
    floor_m = 0.0
    if lidar_z_m <= MOUNT_KNOWN_M:
        # The lowest twentieth of the near points is taken for the floor.
        near_z_m = z_m[range_m < NEAR_FLOOR_M]
        floor_m = float(np.quantile(near_z_m, 0.05)) if len(near_z_m) else lidar_z_m
    label_supported(image, seen)
    a, b, c = grow_ground(found, floor_m)
    return np.array([a, b, c - a * transform[0, 3] - b * transform[1, 3]])


def _all_obstacles(image: Image, seen: Isolated, lidar_z_m: float) -> Float:
    """Whatever neighbours support, at its height above base's floor."""
    label_supported(image, seen)
    image.held.height_m[:] = height_without_ground(image.held.z_m, lidar_z_m)
    return np.zeros(3)


def _floor_below(seen: Isolated, descending: NDArray[np.bool_], lidar_z_m: float) -> float:
    """Median height of the lowest beam with enough returns."""
    for row in np.flatnonzero(descending):
        heights_m = seen.z_m[row][seen.good[row] != 0]
        if len(heights_m) >= seen.good.shape[1] // 20:
            return float(np.median(heights_m))
    return lidar_z_m


def _as_ground(plane: Float) -> GroundPlane:
    size = float(np.sqrt(plane[0] ** 2 + plane[1] ** 2 + 1.0))
    return GroundPlane(np.array([-plane[0], -plane[1], 1.0]) / size, -float(plane[2]) / size)
