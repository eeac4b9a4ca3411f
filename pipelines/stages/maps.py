"""Stages `filter` and `map`: classify the clouds, and place them on the grid at the robot's poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby, islice
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.lidar.classified_scan import FEWEST_RETURNS, PointClass
from quadlog.lidar.deskew import Skewed, slot_poses
from quadlog.lidar.levelling import NotLevelled
from quadlog.mapping.grid import GrowingLattice, SlidingLattice, window_around
from quadlog.mapping.memory import AccumulatedMap, GroundHeight, LogOddsMemory
from quadlog.mapping.placing import NO_TOP, PlacingSettings, place_scan, reach_of
from quadlog.messages import Float
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.log import LogData
from quadlog.pipelines.stages.scans import MOST_AHEAD, ROUTE_WORDS, Scanner, TimedScan, even_sample
from quadlog.pipelines.stages.tracks import Tracks
from quadlog.recordings.types import PLANAR_SCANS
from quadlog.results.arrays import MapsWriter, write_arrays
from quadlog.results.tables import TABLES, TableWriter
from quadlog.storage.formats.ros_map import write_rosmap


def filter_scans(folder: Path, journal: Journal, config: Config, data: LogData, tracks: Tracks, seed: int) -> None:
    """Stage `filter` alone: scans.parquet and the cloud samples."""
    with journal.clock.stage("filter"):
        for _ in _filtered(folder, journal, config, data, tracks, Scanner(config, seed, data)):
            pass


def filter_and_map(folder: Path, journal: Journal, config: Config, data: LogData, tracks: Tracks, seed: int) -> None:
    """Stages `filter` and `map`: also maps.npz, map.pgm with map.yaml, and ground.npz."""
    shape = config.grid.size_cells, config.grid.size_cells
    with (
        journal.clock.stage("filter", "map") as lap,
        MapsWriter(folder / "maps.npz", config.grid.cell_m, shape) as maps,
    ):
        mapper, scanner = _Mapper(config, maps), Scanner(config, seed, data)
        for scan, place in _filtered(folder, journal, config, data, tracks, scanner):
            lap("filter")
            mapper.add(journal, scan, place)
            lap("map")
        lap("filter")
        mapper.write(folder, journal, config.lidar.pose_gap_s)
        lap("map")


class ScanPlace(NamedTuple):
    """Poses x, y, yaw (3,) at a scan's stamp and (K, 3) at its time slots, NaN where unknown.

    skewed: why the scan cannot be deskewed by them, or None. target_m: (2,) where the followed body is, NaN if nowhere.
    """

    pose: Float
    slot_pose: Float
    skewed: Skewed | None
    target_m: Float


ROUNDING_NS = 1_000_000
"""Of a scan's middle, which is found from its times in two ways."""


def places_of(scans: Sequence[TimedScan], tracks: Tracks, max_gap_s: float) -> Iterator[ScanPlace]:
    """The places of scans, by their stamps and the middles of their time slots (K,) each.

    Poses of one scan take as long to find as those of several.
    """
    robot, target = tracks.robot, tracks.target
    for _, alike in groupby(scans, lambda scan: len(scan.slot_ns)):
        at_ns = np.array([(scan.t_ns, *scan.slot_ns.tolist()) for scan in alike], np.int64)
        found = robot.poses_at(at_ns.ravel(), max_gap_s).reshape(*at_ns.shape, 3)
        if robot.source == "lidar":
            # A scan that gave no pose at its own middle was lost: it shows another place than the map's.
            middle_ns = at_ns[:, 1] + (at_ns[:, -1] - at_ns[:, 1]) // 2
            first, end = (np.searchsorted(robot.t_ns, middle_ns + off_ns) for off_ns in (-ROUNDING_NS, ROUNDING_NS))
            found[end <= first] = np.nan
        slot_pose, skewed = slot_poses(at_ns, found)
        skewed = skewed if robot.source != "fixed" else [Skewed.NO_TIMES] * len(at_ns)
        # Returns of a target with a body are kept out of the map.
        if target is not None and target.has_body:
            target_m = target.at(at_ns[:, 0])
        else:
            target_m = np.full((len(at_ns), 2), np.nan)
        yield from map(ScanPlace, found[:, 0], slot_pose, skewed, target_m)


def deskewed(xyz_m: Float, slot: NDArray[np.uint8], pose: Float, slot_pose: Float) -> NDArray[np.float32]:
    """Points (N, 3) of base at their time slots (N,) of slot_pose (K, 3), moved into base at a pose (3,)."""
    cos, sin = np.cos(slot_pose[:, 2])[slot], np.sin(slot_pose[:, 2])[slot]
    x_m, y_m = slot_pose[slot, :2].T - pose[:2, None]
    x_m, y_m = x_m + cos * xyz_m[:, 0] - sin * xyz_m[:, 1], y_m + sin * xyz_m[:, 0] + cos * xyz_m[:, 1]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.column_stack([cos * x_m + sin * y_m, cos * y_m - sin * x_m, xyz_m[:, 2]]).astype(np.float32)


def _filtered(
    folder: Path, journal: Journal, config: Config, data: LogData, tracks: Tracks, scanner: Scanner
) -> Iterator[tuple[TimedScan, ScanPlace]]:
    """Every scan with its place; writes its row, and at the end the samples, and what is to be known of all."""
    journal.progress.begin("filter", len(data.streams.clouds_ns))
    tally, gap_s = _Tally(), config.lidar.pose_gap_s
    sampled, samples = even_sample(len(data.streams.clouds_ns), config.results.cloud_samples), list[_Sample]()
    with TableWriter(folder / "scans.parquet", TABLES["scans"]) as table:
        for number, (scan, place) in enumerate(_placed(scanner, data, tracks, gap_s)):
            table.add_row(scan.row)
            if number in sampled:
                samples.append(_Sample.of(scan, place))
            tally.count(journal, scan, place)
            yield scan, place
            journal.progress.advance((scan.t_ns - data.first_ns) * 1e-9)
    write_arrays(folder, "cloud_samples", _samples(samples))
    journal.lose(data.log.recording.losses)
    journal.warn(*data.log.recording.warnings)
    if (doubt := data.mount.warning()) is not None:
        journal.warn(doubt)
    if config.lidar.deskew:
        journal.warn(*data.point_times.warnings(journal.counts.get("scans", 0)))
    lidars = data.log.lidars
    planar = all({*data.log.recording.types_of(topic)} <= PLANAR_SCANS for topic in lidars)
    where = f" ({', '.join(lidars)}: {data.log.roles.of_topic(lidars[0])[1]})"
    tally.tell(journal, config, where, planar=planar)


def _placed(scanner: Scanner, data: LogData, tracks: Tracks, gap_s: float) -> Iterator[tuple[TimedScan, ScanPlace]]:
    # The workers of a batch share the cores already.
    scans = scanner.all(data.turns(), cores() if parent_process() is None else 1)
    while block := list(islice(scans, MOST_AHEAD)):
        yield from zip(block, places_of(block, tracks, gap_s), strict=True)


UNUSUAL = {
    "scans_without_points": f"fewer than {FEWEST_RETURNS} points on the ground or on obstacles; they are in no map",
    "scans_without_ground": "no ground is found, as in a 2-D scan; heights are measured from base as configured",
    "scans_with_steep_ground": "the ground plane is too steep, probably a wall; points "
    "in it are missing from those maps",
}


class _Tally:
    """Numbers of scans by what is to be known of them."""

    def __init__(self) -> None:
        self._routes: Counter[str] = Counter()
        self._skewed: Counter[Skewed] = Counter()
        self._tilted: Counter[NotLevelled] = Counter()

    def count(self, journal: Journal, scan: TimedScan, place: ScanPlace) -> None:
        """One scan more."""
        journal.count("scans")
        if scan.not_levelled is not None:
            self._tilted[scan.not_levelled] += 1
        if scan.found.shows_nothing:
            journal.count("scans_without_points")
            return
        self._routes[scan.found.route] += 1
        if (reason := scan.skewed or place.skewed) is not None:
            self._skewed[reason] += 1
        if not scan.level:
            journal.count("scans_without_ground" if scan.level is None else "scans_with_steep_ground")

    def tell(self, journal: Journal, config: Config, why: str, *, planar: bool) -> None:
        """Notes on the classification, and warnings of unusual scans; why: the lidar's topic and why it was chosen.

        planar: whether its messages have no beams to number.
        """
        journal.use("lidar")
        n = journal.counts.get("scans", 0)
        for route, count in self._routes.most_common():
            words = ROUTE_WORDS["planar" if planar and route == "rings" else route]
            journal.note(f"{count} of {self._routes.total()} scans classified {words}")
        for reason, count in self._skewed.items():
            journal.count("scans_not_deskewed", count)
            if reason is not Skewed.NO_TIMES and config.lidar.deskew:
                journal.warn(f"{count} of {n} scans are not deskewed: {reason.value}")
        for why_not, count in self._tilted.items():
            journal.count("scans_not_levelled", count)
            journal.warn(f"{count} of {n} scans are not levelled: {why_not.value}")
        for name, text in UNUSUAL.items():
            if count := journal.counts.get(name, 0):
                journal.warn(f"{count} of {n} scans: {text}" + (why if count == n else ""))


class _Sample(NamedTuple):
    """A whole scan for figures: xyz_m (N, 3) in base at its instant and label (N,); pose (3,) of base, or NaN."""

    t_ns: int
    xyz_m: NDArray[np.float32]
    label: NDArray[np.uint8]
    pose: Float

    @classmethod
    def of(cls, scan: TimedScan, place: ScanPlace) -> _Sample:
        returns = scan.found.returns
        valid = returns.label != PointClass.INVALID
        xyz_m, slot = scan.found.xyz_base_m[valid], returns.slot[valid]
        if np.isfinite(place.pose).all():
            xyz_m = deskewed(xyz_m, slot, place.pose, place.slot_pose)
        return cls(scan.t_ns, xyz_m, returns.label[valid], place.pose)


def _samples(scans: Sequence[_Sample]) -> dict[str, Any]:
    """The arrays of `cloud_samples.npz`."""
    pose_at = np.array([scan.pose for scan in scans], np.float64).reshape(-1, 3)
    return {
        "t_ns": [scan.t_ns for scan in scans],
        "offset": np.cumsum([0, *(len(scan.label) for scan in scans)], dtype=np.int64),
        "xyz_m": np.concatenate([np.empty((0, 3), np.float32), *(scan.xyz_m for scan in scans)], dtype=np.float32),
        "label": np.concatenate([np.empty(0, np.uint8), *(scan.label for scan in scans)], dtype=np.uint8),
        **dict(zip(("x_m", "y_m", "yaw_rad"), pose_at.T, strict=True)),
        "classes": [each.name.lower() for each in PointClass],
    }


class _Mapper:
    """Lays scans on the grid, one after the other: the map at each, and those of the whole run."""

    def __init__(self, config: Config, maps: MapsWriter) -> None:
        self._grid, self._height_mm, self._maps = config.grid, round(config.robot.body_m[2] * 1000), maps
        self._placing = _placing_settings(config)
        self._memory = make_memory(config)
        self._whole = AccumulatedMap(config.grid.cell_m)
        self._ground = GroundHeight(config.results.ground_cell_m)

    def add(self, journal: Journal, scan: TimedScan, place: ScanPlace) -> None:
        """One scan more, in time order."""
        if scan.found.shows_nothing:
            return
        if not np.isfinite(place.pose).all():
            journal.count("scans_without_pose")
            return
        window = window_around(place.pose[:2], self._grid.cell_m, self._grid.size_cells)
        placed = place_scan(scan.found, place.slot_pose, window, place.target_m, self._placing)
        now = placed.top_mm > NO_TOP if self._memory is None else self._memory.add(scan.t_ns, window, placed)
        self._maps.append(scan.t_ns, window.origin_m, now)
        # An obstacle lower than the robot blocks, even if rays pass above it.
        self._whole.add(window, placed, self._height_mm)
        # A wall taken for the ground says nothing about the height of the floor.
        if scan.level:
            self._ground.add(scan.found, place.slot_pose, reach_of(scan.found, window))

    def write(self, folder: Path, journal: Journal, gap_s: float) -> None:
        """The map of the whole run and its ground; and what is in no map."""
        if (whole := self._whole.to_cells()) is not None:
            cells, window = whole
            write_rosmap(folder, cells, window.origin_m, window.cell_m)
        if (ground := self._ground.to_map()) is not None:
            height_m, count, window = ground
            corner = {"origin_m": window.origin_m, "cell_m": window.cell_m}
            write_arrays(folder, "ground", corner | {"height_m": height_m, "count": count})
        for name, skipped in (("map.pgm", self._whole.lattice.skipped), ("ground.npz", self._ground.lattice.skipped)):
            if skipped:
                journal.warn(f"{name}: {skipped} scans left out, the run covers more ground than the file may grow to")
        if self._memory is not None and (skipped := self._memory.lattice.skipped):
            journal.warn(f"{skipped} maps hold one scan alone: the run covers more than memory may grow to")
        if lost := journal.counts.get("scans_without_pose", 0):
            none = "" if self._whole.to_cells() is not None else "; if their clock differs, try  --stamp log"
            journal.warn(f"{lost} scans are not in the map: no pose within {gap_s} s of them{none}")


ABOVE_M = 0.1
"""Margin above the highest relevant height within which rays are kept."""


def _placing_settings(config: Config) -> PlacingSettings:
    grid, (length_m, width_m, height_m) = config.grid, config.robot.body_m
    return PlacingSettings(
        min_height_m=grid.min_height_m,
        max_height_m=grid.max_height_m,
        body_length_m=length_m,
        body_width_m=width_m,
        highest_m=max(grid.max_height_m, height_m) + ABOVE_M,
        min_points=grid.min_points,
        target_radius_m=grid.target_radius_m,
    )


def make_memory(config: Config) -> LogOddsMemory | None:
    """The memory of the section grid; None where a map is its scan."""
    grid, layers = config.grid, LogOddsMemory.LAYERS
    if grid.memory == "scan":
        return None
    lattice = SlidingLattice if grid.extent == "window" else GrowingLattice
    return LogOddsMemory(lattice(grid.cell_m, layers), grid.clear_s)
