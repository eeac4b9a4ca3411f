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
    Returns,
    Route,
    class_counts,
    height_without_ground,
    lidar_above,
    outside_view,
)
from quadlog.lidar.deskew import sweep_slots
from quadlog.lidar.ground import label_ground
from quadlog.lidar.height_map import grow_ground
from quadlog.lidar.paper_method import PaperSettings, classify_as_paper
from quadlog.lidar.range_image import (
    Beams,
    Image,
    Keys,
    beams_by_bins,
    beams_by_elevation,
    beams_by_number,
    elevation_keys,
    isolate,
    lay,
    phase_and_strangers,
    to_polar,
)
from quadlog.messages import Float, Float32, PointCloud

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
    """A message as it is laid into an image: places (3, N) in the lidar's frame, rings or None, and time slots (N,).

    transforms: (2, 4, 4) to base made upright, and its change per slot.
    """

    xyz_m: Float32
    ring: Keys | None
    slot: NDArray[np.uint8]
    transforms: Float


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """The sensor's beams, and what was seen in the scan in which they were found.

    strange: share of its points off their beams or without a cell of their own.
    """

    beams: Beams
    route: Route
    n_points: int
    strange: float


class Seen(NamedTuple):
    """What the scans before one have shown: the beams, None where none are known, and the scans since they were found.

    It is equal to another one only if both have the beams from one and the same scan.
    """

    known: _Known | None = None
    scans: int = 0

    def foreseen(self) -> Seen | None:
        """What it will be after one scan more that contradicts nothing; None where that one looks for beams again."""
        if self.known is None:
            return self
        return self._replace(scans=self.scans + 1) if self.scans < SCANS_BETWEEN_LOOKS else None


class ScanClassifier:
    """Classifies the scans of one lidar, one after the other, or in any thread by what those before have shown.

    The beams are found in the first scan and looked for again when a scan contradicts them, and every
    SCANS_BETWEEN_LOOKS scans. uses_times: whether the points' own times count; without them all of a scan is in one
    time slot.
    """

    def __init__(self, settings: RangeImageSettings | PaperSettings, seed: int = 0, *, uses_times: bool = True) -> None:
        self._settings, self._seed, self._uses_times = settings, seed, uses_times
        self._ranges_m = float(settings.min_range_m), float(settings.max_range_m)
        self._seen = Seen()

    def classify(self, cloud: PointCloud, transform_lidar_to_level: Float) -> ClassifiedScan:
        """The classified points of the next cloud, as `classify_after`."""
        found, self._seen = self.classify_after(self._seen, cloud, transform_lidar_to_level)
        return found

    def classify_after(
        self, seen: Seen, cloud: PointCloud, transform_lidar_to_level: Float
    ) -> tuple[ClassifiedScan, Seen]:
        """The classified points of a cloud, any values accepted, and what is seen with it; seen: in those before it.

        transform_lidar_to_level: (4, 4) to base made upright, or (2, 4, 4) at the first and the last point's time.
        Ring numbers that contradict the elevations are ignored. The whole scan is classified and then cropped to the
        field of view: points outside it help to judge those inside.
        """
        transforms, settings, n = transform_lidar_to_level.reshape(-1, 4, 4), self._settings, len(cloud.xyz_m)
        slot, slot_ns = sweep_slots(cloud.times if self._uses_times else None, n)
        if isinstance(settings, PaperSettings):
            level = transforms.mean(axis=0)
            return classify_as_paper(cloud.xyz_m, slot, slot_ns, level, settings, self._seed), seen
        moving = np.empty((2, 4, 4))
        moving[0], moving[1] = transforms[0], (transforms[-1] - transforms[0]) / max(len(slot_ns) - 1, 1)
        # Heights are measured, and the plane lies, about where the lidar is on average.
        moving[0, :3, 3], moving[1, :3, 3] = (transforms[0, :3, 3] + transforms[-1, :3, 3]) / 2, 0.0
        with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinity, which is no return
            xyz_m = np.array(cloud.xyz_m.T, np.float32, order="C")
        rings = cloud.ring is not None and len(cloud.ring) == n
        scan = _Scan(xyz_m, np.array(cloud.ring, np.uint16) if rings else None, slot, moving)
        laid = None
        if abs(moving[0, 2, 2]) >= MOST_TILT_COSINE:
            laid, seen = self._lay_beams(scan, seen)
        if laid is not None and (known := seen.known) is not None:
            image, returns = laid
            plane, route = _label_beams(image, returns, known.beams, moving[0]), known.route
        else:
            image, returns = self._lay_bins(scan)
            plane, route = _label_bins(image, returns, moving[0]), "height_map"
        label = returns.label
        if settings.field_of_view_deg < 360:
            x_m, y_m = returns.dx_m + np.float32(moving[0, 0, 3]), returns.dy_m + np.float32(moving[0, 1, 3])
            outside = outside_view(x_m, y_m, settings.field_of_view_deg)
            label[outside & (label != PointClass.INVALID)] = PointClass.CROPPED
        counts, columns = class_counts(label), image.range_m.shape[1]
        ground = _as_ground(plane) if counts[PointClass.GROUND] >= settings.ground_min_points else None
        place_m = lidar_above(ground, moving[0])
        return ClassifiedScan(returns, counts, columns, ground, route, place_m, slot_ns), seen

    def _lay_beams(self, scan: _Scan, seen: Seen) -> tuple[tuple[Image, Returns] | None, Seen]:
        """The scan in an image of its beams, None where it shows none, and what is seen with it."""
        known, n, upright = seen.known, len(scan.slot), bool(scan.transforms[0, 2, 2] > 0)
        after = seen.foreseen()
        if known is not None and after is not None and abs(n - known.n_points) <= known.n_points // 4:
            image, returns, strange = self._lay_on(known.beams, known.route, scan)
            if strange <= known.strange + _CHANGED_SHARE:
                return (image, returns), after
        polar = to_polar(scan.xyz_m, self._ranges_m)
        route: Route = "rings"
        beams = None if scan.ring is None else beams_by_number(polar, scan.ring, upright)
        if beams is None:
            route, beams = "elevations", beams_by_elevation(polar, upright)
        if beams is None:
            return None, Seen()
        image, returns, strange = self._lay_on(beams, route, scan)
        return (image, returns), Seen(_Known(beams, route, n, strange))

    def _lay_on(self, beams: Beams, route: Route, scan: _Scan) -> tuple[Image, Returns, float]:
        """The scan in an image of these beams, and the share of points off them or without a cell of their own."""
        key = scan.ring if route == "rings" else None
        if key is None:
            key = elevation_keys(to_polar(scan.xyz_m, self._ranges_m).sine)
        phase, strangers = phase_and_strangers(scan.xyz_m, key, beams, self._ranges_m)
        image, returns, hidden = lay(scan.xyz_m, key, scan.slot, beams, scan.transforms, self._ranges_m, phase)
        return image, returns, strangers + hidden / max(len(key), 1)

    def _lay_bins(self, scan: _Scan) -> tuple[Image, Returns]:
        """The scan in an image by directions along base's axes from the lidar's place."""
        turn = scan.transforms[0, :3, :3].astype(np.float32)
        with np.errstate(all="ignore"):
            xyz_m = np.stack([row[0] * scan.xyz_m[0] + row[1] * scan.xyz_m[1] + row[2] * scan.xyz_m[2] for row in turn])
        polar = to_polar(xyz_m, self._ranges_m)
        beams, key = beams_by_bins(polar.range_m, polar.sine)
        unturned = np.stack([np.eye(4), np.zeros((4, 4))])
        unturned[0, 2, 3] = scan.transforms[0, 2, 3]
        return lay(xyz_m, key, scan.slot, beams, unturned, self._ranges_m, 0.0)[:2]


def _label_beams(image: Image, returns: Returns, beams: Beams, transform: Float) -> Float:
    """Fill labels and heights of an image of beams; the plane (3,) z = a x + b y + c through the ground, in base."""
    lidar_z_m = float(transform[2, 3])
    good = isolate(image, np.float32(lidar_z_m), returns.label)
    if len(good) < FEWEST_BEAMS:
        return _all_obstacles(returns, lidar_z_m)
    floor_m = 0.0
    if lidar_z_m <= MOUNT_KNOWN_M:
        # The median height of the lowest beam with enough returns.
        enough = np.flatnonzero(beams.descending & (good.sum(axis=1) >= good.shape[1] // 20))
        floor_m = float(np.median(image.z_m[enough[0]][good[enough[0]]])) if len(enough) else lidar_z_m
    return label_ground(image, returns, good, beams.descending, floor_m, transform)


def _label_bins(image: Image, returns: Returns, transform: Float) -> Float:
    """The same of an image of bins, on a map of lowest points."""
    lidar_z_m, range_m = float(transform[2, 3]), image.point_range_m
    isolate(image, np.float32(lidar_z_m), returns.label)
    range_m, z_m = range_m[range_m > 0], returns.z_m[range_m > 0]
    sine = (z_m - np.float32(lidar_z_m)) / range_m
    if len(sine) == 0 or np.ptp(sine) < FLATTEST_CLOUD:
        return _all_obstacles(returns, lidar_z_m)
    floor_m = 0.0
    if lidar_z_m <= MOUNT_KNOWN_M:
        # The lowest twentieth of the near points is taken for the floor.
        near_z_m = z_m[range_m < NEAR_FLOOR_M]
        floor_m = float(np.quantile(near_z_m, 0.05)) if len(near_z_m) else lidar_z_m
    a, b, c = grow_ground(returns, floor_m)
    return np.array([a, b, c - a * transform[0, 3] - b * transform[1, 3]])


def _all_obstacles(returns: Returns, lidar_z_m: float) -> Float:
    """Whatever neighbours support, at its height above base's floor."""
    returns.height_m[:] = height_without_ground(returns.z_m, lidar_z_m)
    return np.zeros(3)


def _as_ground(plane: Float) -> GroundPlane:
    size = float(np.sqrt(plane[0] ** 2 + plane[1] ** 2 + 1.0))
    return GroundPlane(np.array([-plane[0], -plane[1], 1.0]) / size, -float(plane[2]) / size)
