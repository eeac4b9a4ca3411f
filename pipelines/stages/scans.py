"""Classify clouds as they are read, and keep compact scans on disk until positions are known."""

from __future__ import annotations

import math
import os
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.lidar.classified_scan import FEWEST_RETURNS, ClassifiedReturns, PointClass
from quadlog.lidar.deskew import MAX_OFFSET_NS, Skewed, sweep_slots, sweep_span
from quadlog.lidar.levelling import NotLevelled
from quadlog.lidar.paper_method import PaperSettings
from quadlog.lidar.range_image_method import RangeImageSettings
from quadlog.lidar.ransac_plane import GroundPlane
from quadlog.lidar.scan_classifier import ScanClassifier
from quadlog.mapping.compact import CompactSettings, ObstacleSettings, ScanCompactor, reach_of
from quadlog.messages import Float, Int, PointCloud
from quadlog.pipelines.stages.tilt import Tilt
from quadlog.positioning.lidar_odometry import (
    FEWEST_RETURNS_MATCHED,
    LidarOdometry,
    LidarOdometrySettings,
    LidarTrack,
    ScanMatch,
)
from quadlog.recordings.roles import Roles
from quadlog.storage.atomic_write import part_prefix

Item = TypeVar("Item")


class EvenSample(Generic[Item]):
    """Keep every 2^k-th item of a stream, where k grows so that at most 2 `wanted` items are held.

    expected: length of the stream, from which k starts; None if unknown.
    """

    def __init__(self, wanted: int, expected: int | None = None) -> None:
        self._wanted = wanted
        self._stride, self._seen = 1, 0
        while wanted and (expected or 0) > 2 * wanted * self._stride:
            self._stride *= 2
        self._held: list[Item] = []

    def offer(self, make: Callable[[], Item]) -> None:
        """The next item of the stream; `make` is called only when it is kept."""
        if self._wanted and self._seen % self._stride == 0:
            if len(self._held) == 2 * self._wanted:
                self._held = self._held[::2]
                self._stride *= 2
            if self._seen % self._stride == 0:
                self._held.append(make())
        self._seen += 1

    def kept(self) -> list[Item]:
        """At most `wanted` items, spread over the stream, the first one among them."""
        if len(self._held) <= self._wanted:
            return self._held
        step = len(self._held) / self._wanted
        return [self._held[int(index * step)] for index in range(self._wanted)]


MOST_IN_MEMORY_BYTES = 4 << 20


class Spill(SpooledTemporaryFile[bytes]):
    """Records of bytes, read back in the order in which they were written.

    Up to a bound they stay in memory; beyond it they go to a file in `folder` that has no name: it is gone with the
    process, however that ends. Where the system knows no such files it has the name of an unfinished file for an
    instant. Raises OSError when the disk is full.
    """

    def __init__(self, folder: Path, most_in_memory_bytes: int = MOST_IN_MEMORY_BYTES) -> None:
        super().__init__(most_in_memory_bytes, dir=str(folder), prefix=part_prefix(os.getpid()), suffix=".part")
        self._lengths: list[int] = []

    def append(self, *parts: bytes) -> None:
        """One record, made of parts."""
        self._lengths.append(self.write(b"".join(parts)))

    def __len__(self) -> int:
        return len(self._lengths)

    def __iter__(self) -> Iterator[bytes]:
        self.seek(0)
        for length in self._lengths:
            yield self.read(length)


ROUTE_WORDS = {
    "rings": "by the beams their points name",
    "elevations": "by the beams their elevations show",
    "height_map": "as clouds without beams, on a map of the lowest points",
    "paper": "as in [Following]",
}
ABOVE_M = 0.1
"""Margin above the highest relevant height within which rays are kept."""
_SKEWED = (None, *Skewed)
_ROW = struct.Struct("<qd5q4d?BB")


class ScanRow(NamedTuple):
    """A scan's row of `scans.parquet`, and its time slots (K,). ms: time to classify it.

    skewed: why its points have no times, None if they have. compact: a CompactScan as bytes, for maps.
    """

    t_ns: int
    ms: float
    n_raw: int
    n_valid: int
    n_outlier: int
    n_ground: int
    n_obstacle: int
    normal: tuple[float, float, float]
    d_m: float
    ground_found: bool
    skewed: Skewed | None
    slot_ns: Int
    compact: bytes

    @property
    def shows_nothing(self) -> bool:
        """Whether the scan has too few returns to be used in a map: an empty scan does not show free space."""
        return self.n_ground + self.n_obstacle < FEWEST_RETURNS

    @property
    def ground(self) -> GroundPlane | None:
        """The plane, without its inliers."""
        return GroundPlane(np.array(self.normal), self.d_m, np.empty(0, np.bool_)) if self.ground_found else None

    def append_to(self, spill: Spill) -> None:
        """Write it down."""
        codes = self.ground_found, _SKEWED.index(self.skewed), len(self.slot_ns)
        spill.append(_ROW.pack(*self[:7], *self.normal, self.d_m, *codes), self.slot_ns.tobytes(), self.compact)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """What `append_to` wrote."""
        t_ns, ms, raw, valid, outlier, ground, obstacle, nx, ny, nz, d_m, found, skewed, slots = _ROW.unpack_from(data)
        counts = raw, valid, outlier, ground, obstacle
        slot_ns = np.frombuffer(data, np.int64, slots, _ROW.size)
        rest = data[_ROW.size + 8 * slots :]
        return cls(t_ns, ms, *counts, (nx, ny, nz), d_m, found, _SKEWED[skewed], slot_ns, rest)


class WholeScan(NamedTuple):
    """All valid points of a scan kept for figures: xyz_m (N, 3) in base, label and time slot (N,)."""

    t_ns: int
    xyz_m: NDArray[np.float32]
    label: NDArray[np.uint8]
    slot: NDArray[np.uint8]
    slot_ns: Int


@dataclass(frozen=True, slots=True)
class ScanTally:
    """Number of scans by classification route, and of those not levelled, by reason."""

    routes: Counter[str] = field(default_factory=Counter)
    tilted: Counter[NotLevelled] = field(default_factory=Counter)


@dataclass(frozen=True, slots=True)
class ScanSettings:
    """Settings for reducing scans; compact: None where no maps are made."""

    classifier: RangeImageSettings | PaperSettings
    compact: CompactSettings | None
    deskew: bool
    samples: int

    @classmethod
    def of_config(cls, config: Config, *, maps: bool) -> Self:
        """The sections lidar, ground and, for maps, grid, as the algorithms take them."""
        compact = _compact_settings(config) if maps else None
        return cls(_classifier_settings(config), compact, config.lidar.deskew, config.results.cloud_samples)


class Scanner:
    """Classify clouds one by one, and write the reduced scans to the spill."""

    def __init__(
        self,
        settings: ScanSettings,
        seed: int,
        transform_lidar_to_base: Float,
        tilt: Tilt,
        spill: Spill,
        expected: int | None = None,
    ) -> None:
        """expected: number of clouds, if known."""
        self.tally, self.spill = ScanTally(), spill
        self.samples: EvenSample[WholeScan] = EvenSample(settings.samples, expected)
        self._classifier = ScanClassifier(settings.classifier, seed, uses_times=settings.deskew)
        self._compactor: ScanCompactor | None = None
        if settings.compact is not None:
            # Windows are centred on base, compact scans on the lidar.
            reach_m = settings.compact.reach_m + math.hypot(*transform_lidar_to_base[:2, 3])
            self._compactor = ScanCompactor(replace(settings.compact, reach_m=reach_m))
        self._tilt, self._transform_lidar_to_base = tilt, transform_lidar_to_base

    def take(self, t_ns: int, cloud: PointCloud) -> None:
        """The next cloud."""
        started = time.perf_counter()
        first_ns, last_ns = _sweep(cloud)
        rotations, not_levelled = self._tilt.rotations(np.array([t_ns + first_ns, t_ns + last_ns], dtype=np.int64))
        transforms = np.tile(self._transform_lidar_to_base, (2, 1, 1))
        transforms[:, :3] = rotations @ transforms[:, :3]
        returns = self._classifier.classify(cloud, transforms)
        compact = b"" if self._compactor is None else self._compactor.compact(returns, t_ns).to_bytes()
        row = _row(t_ns, (time.perf_counter() - started) * 1e3, returns, compact)
        row.append_to(self.spill)
        if not_levelled is not None:
            self.tally.tilted[not_levelled] += 1
        if not row.shows_nothing:
            self.tally.routes[returns.route] += 1
        self.samples.offer(partial(_whole, t_ns, cloud, returns))


def wants_lidar_track(config: Config, roles: Roles, by_uwb: bool) -> bool:
    """Whether the robot is tracked by the lidar: as configured, or under auto where nothing else gives its position.

    by_uwb: whether there are ranges and anchors.
    """
    position = config.topics.position
    if "lidar" not in roles.found:
        return False
    if position == "lidar" or (by_uwb and config.lidar.odometry):
        return True
    if position != "auto":
        return False
    moving_tf = [topic for topic in roles.topics("tf") if topic.rsplit("/", 1)[-1] != "tf_static"]
    return not (by_uwb or moving_tf or roles.topic("odometry") or "joints" in roles.found)


class LidarTracker:
    """Takes clouds one by one, levelled by the tilt known then."""

    def __init__(self, config: Config, transform_lidar_to_base: Float, tilt: Tilt) -> None:
        lidar = config.lidar
        # Points too far for the map still tell where the robot is.
        settings = LidarOdometrySettings(min_range_m=lidar.min_range_m)
        self._odometry, self._deskew = LidarOdometry(settings), lidar.deskew
        self._mount, self._tilt = transform_lidar_to_base, tilt
        self._levelled: list[Float] = []
        self._scans = 0

    def take(self, t_ns: int, cloud: PointCloud) -> None:
        """The next cloud."""
        self._scans += 1
        known = len(self._odometry)
        span = sweep_span(cloud.times, len(cloud.xyz_m)) if self._deskew else Skewed.NO_TIMES
        offset_ns, middle_ns = None, t_ns
        if not isinstance(span, Skewed):
            offset_ns, middle_ns = cloud.offset_ns, t_ns + sum(span) // 2
        rotations, _ = self._tilt.rotations(np.array([middle_ns], dtype=np.int64))
        rotation = (rotations[0] @ self._mount[:3, :3]).astype(np.float32)
        shift_m = (rotations[0] @ self._mount[:3, 3]).astype(np.float32)
        self._odometry.take(t_ns, cloud.xyz_m @ rotation.T + shift_m, offset_ns)
        self._levelled += [rotations[0]] * (len(self._odometry) - known)

    def track(self) -> LidarTrack:
        """Poses of base at the middle of each scan; the frame is base at the first scan, with z up.

        Where no tilt is known to level scans by, z of the frame is that of base at the first scan.
        """
        matched = self._odometry.track()
        return replace(matched, rotation=matched.rotation @ np.array(self._levelled).reshape(-1, 3, 3))

    def lost_share(self) -> float:
        """Share of the scans that tell no pose."""
        return 1 - (self._odometry.track().match != ScanMatch.LOST).sum() / max(self._scans, 1)

    def why_lost(self) -> str:
        """Why scans tell no pose; empty where all do."""
        track = self._odometry.track()
        lost = self._scans - int((track.match != ScanMatch.LOST).sum())
        if not lost:
            return ""
        few = f"have fewer than {FEWEST_RETURNS_MATCHED} returns"
        text = f"{lost} of {self._scans} scans {few} or match nothing seen before"
        gave_up_ns = self._odometry.gave_up_ns
        if gave_up_ns is None:
            return text
        return f"{text}; the track ends {(gave_up_ns - track.t_ns[0]) * 1e-9:.1f} s after its start, where most do"

    def warnings(self) -> list[str]:
        """How many scans do not tell the whole pose, and why."""
        match = self._odometry.track().match
        sliding = (match == ScanMatch.DEGENERATE).sum()
        lines = [f"{why}: no pose is given there"] if (why := self.why_lost()) else []
        if sliding:
            lines.append(
                f"{sliding} of {len(match)} scans show surfaces that face one way, as a corridor does: along them "
                "positions may slide"
            )
        return lines


def _classifier_settings(config: Config) -> RangeImageSettings | PaperSettings:
    lidar, ground = config.lidar, config.ground
    if lidar.method == "paper":
        return PaperSettings(
            min_range_m=lidar.min_range_m,
            max_range_m=lidar.max_range_m,
            field_of_view_deg=lidar.field_of_view_deg or 180.0,
            outlier_neighbours=lidar.outlier_neighbours,
            outlier_std_ratio=lidar.outlier_std_ratio,
            ground_distance_m=ground.distance_m,
            ground_confidence=ground.confidence,
            ground_inlier_share=ground.inlier_share,
            ground_min_points=ground.min_points,
        )
    return RangeImageSettings(
        min_range_m=lidar.min_range_m,
        max_range_m=lidar.max_range_m,
        field_of_view_deg=lidar.field_of_view_deg or 360.0,
        ground_min_points=ground.min_points,
    )


def _compact_settings(config: Config) -> CompactSettings:
    grid, robot = config.grid, config.robot
    blocking = ObstacleSettings(
        min_height_m=grid.min_height_m,
        max_height_m=grid.max_height_m,
        body_length_m=robot.length_m,
        body_width_m=robot.width_m,
    )
    return CompactSettings(
        blocking,
        reach_m=reach_of(grid.cell_m, grid.size_cells),
        highest_m=max(grid.max_height_m, robot.height_m) + ABOVE_M,
        ground_cell_m=config.results.ground_cell_m,
        counts=grid.min_points > 1,
    )


def end_of_sweep_ns(t_ns: int, cloud: PointCloud) -> int:
    """When the last point of a cloud with this stamp was measured."""
    return t_ns + _sweep(cloud)[1]


def _sweep(cloud: PointCloud) -> tuple[int, int]:
    """Times of the first and last point relative to the stamp; 0 if they are implausible."""
    if cloud.times is None or len(cloud.times) == 0:
        return 0, 0
    first_ns, last_ns = cloud.times.first_ns, cloud.times.last_ns
    return (first_ns, last_ns) if max(abs(first_ns), abs(last_ns)) <= MAX_OFFSET_NS else (0, 0)


def _row(t_ns: int, ms: float, returns: ClassifiedReturns, compact: bytes) -> ScanRow:
    ground = returns.ground
    nx, ny, nz = (np.nan, np.nan, np.nan) if ground is None else ground.normal.tolist()
    counts = returns.n_raw, returns.n_valid, returns.n_outlier, returns.n_ground, returns.n_obstacle
    d_m = np.nan if ground is None else ground.d_m
    slot_ns = t_ns + returns.slots.middle_ns
    return ScanRow(t_ns, ms, *counts, (nx, ny, nz), d_m, ground is not None, returns.slots.skewed, slot_ns, compact)


def _whole(t_ns: int, cloud: PointCloud, returns: ClassifiedReturns) -> WholeScan:
    points, slot = returns.points(), np.zeros(returns.n_raw, np.uint8)
    if returns.slots.skewed is None:
        sweep_slots(cloud.times, slot)
    valid = points.label != PointClass.INVALID
    return WholeScan(t_ns, points.xyz_base_m[valid], points.label[valid], slot[valid], t_ns + returns.slots.middle_ns)
