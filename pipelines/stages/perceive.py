"""Stages `filter` and `map`: write the classified scans, and place them on the grid at the robot's poses.

Scans were classified when they were read, before positions were known.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import compress, islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.lidar.classified_scan import FEWEST_RETURNS, PointClass
from quadlog.lidar.deskew import Skewed, slot_poses
from quadlog.lidar.ransac_plane import is_level
from quadlog.mapping.accumulated_map import AccumulatedMap, GroundHeight
from quadlog.mapping.compact import CompactScan
from quadlog.mapping.grid import window_around
from quadlog.mapping.lattice import GrowingLattice, Layers, SlidingLattice
from quadlog.mapping.memory import DecayMemory, LogOddsMemory, Memory, ScanMemory
from quadlog.mapping.placing import ScanPlacer
from quadlog.messages import Float, Int
from quadlog.pipelines.stages.context import ReplayContext
from quadlog.pipelines.stages.scans import ROUTE_WORDS, Scanner, ScanRow, WholeScan
from quadlog.results.arrays import ARRAYS, MapsWriter
from quadlog.results.tables import TABLES, TableWriter
from quadlog.storage.formats.ros_map import write_rosmap


class ScanPlace(NamedTuple):
    """Poses x, y, yaw (3,) at a scan's stamp and (K, 3) at its time slots, and position (2,) of a target with a body.

    NaN where unknown.
    """

    pose: Float
    slot_pose: Float
    target_m: Float


class ScanPoses:
    """Poses at stamps and time slots; skewed: number of scans that are not deskewed, by reason."""

    def __init__(self, walk: ReplayContext) -> None:
        self.skewed: Counter[Skewed] = Counter()
        self._walk, self._gap_s = walk, walk.config.lidar.pose_gap_s
        self._moves = walk.robot is not None and walk.robot.source != "fixed"
        self._matched = walk.robot is not None and walk.robot.source == "lidar"

    def of(self, rows: Sequence[ScanRow]) -> list[ScanPlace]:
        """The places of scans; counts those that are not deskewed."""
        bounds = np.cumsum([0, *(1 + len(row.slot_ns) for row in rows)]).tolist()
        found = self._poses(np.concatenate([part for row in rows for part in ([row.t_ns], row.slot_ns)]))
        targets_m = self._walk.solid_targets_at(np.array([row.t_ns for row in rows], np.int64))
        places = []
        for row, target_m, begin, end in zip(rows, targets_m, bounds[:-1], bounds[1:], strict=True):
            if self._matched and not self._is_matched(row):
                found[begin:end] = np.nan
            at_slots, skewed = slot_poses(row.t_ns, row.slot_ns, found[begin:end])
            reason = row.skewed or (skewed if self._moves else Skewed.NO_TIMES)
            if reason is not None and not row.shows_nothing:
                self.skewed[reason] += 1
            places.append(ScanPlace(found[begin], at_slots, target_m))
        return places

    def at(self, t_ns: int, slot_ns: Int) -> tuple[Float, Float]:
        """Pose and slot poses of one scan, without counting."""
        found = self._poses(np.concatenate([[t_ns], slot_ns]))
        return found[0], slot_poses(t_ns, slot_ns, found)[0]

    def _is_matched(self, row: ScanRow) -> bool:
        """Whether the scan itself gave a pose, at its middle: one that was lost shows another place than the map's."""
        assert self._walk.robot is not None
        middle_ns = int(row.slot_ns[0]) + (int(row.slot_ns[-1]) - int(row.slot_ns[0])) // 2
        at = np.searchsorted(self._walk.robot.t_ns, [middle_ns - ROUNDING_NS, middle_ns + ROUNDING_NS])
        return bool(at[1] > at[0])

    def _poses(self, t_ns: Int) -> Float:
        if self._walk.robot is None:
            return np.full((len(t_ns), 3), np.nan)
        return self._walk.robot.poses_at(np.asarray(t_ns, dtype=np.int64), self._gap_s)


ROUNDING_NS = 1_000_000
"""Of a scan's middle, which is found from its times in two ways."""


def deskewed(xyz_m: Float, slot: NDArray[np.uint8], pose: Float, slot_pose: Float) -> NDArray[np.float32]:
    """Points (N, 3) of base at their time slots (N,) of slot_pose (K, 3), moved into base at a pose (3,)."""
    cos, sin = np.cos(slot_pose[:, 2])[slot], np.sin(slot_pose[:, 2])[slot]
    x_m, y_m = slot_pose[slot, :2].T - pose[:2, None]
    x_m, y_m = x_m + cos * xyz_m[:, 0] - sin * xyz_m[:, 1], y_m + sin * xyz_m[:, 0] + cos * xyz_m[:, 1]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.column_stack([cos * x_m + sin * y_m, cos * y_m - sin * x_m, xyz_m[:, 2]]).astype(np.float32)


AT_ONCE = 64
"""Scans whose poses are looked up together."""


def filter_scans(walk: ReplayContext) -> None:
    """Stage `filter` alone: scans.parquet and the cloud samples."""
    with walk.clock.laps("filter"):
        scanner = _begin(walk)
        poses = ScanPoses(walk)
        for _ in _filtered(walk, scanner, poses):
            pass
        _end(walk, scanner, poses)


def filter_and_map(walk: ReplayContext) -> None:
    """Stages `filter` and `map`: also maps.npz, map.pgm with map.yaml, and ground.npz."""
    grid = walk.config.grid
    shape = (grid.size_cells, grid.size_cells)
    with walk.clock.laps("filter", "map") as lap, ExitStack() as stack:
        scanner = _begin(walk)
        poses, mapper = ScanPoses(walk), _Mapper(walk.config)
        maps = stack.enter_context(MapsWriter(walk.run.path / "maps.npz", grid.cell_m, shape))
        for row, place in _filtered(walk, scanner, poses):
            lap("filter")
            _map_scan(walk, row, place, maps, mapper)
            lap("map")
        _end(walk, scanner, poses)
        lap("filter")
        _write_maps(walk, mapper)
        stack.close()
        lap("map")


class _Mapper:
    """Maps that grow over the run, and the placer of scans."""

    def __init__(self, config: Config) -> None:
        self.placer = ScanPlacer(config.grid.min_points, config.grid.target_radius_m)
        self.memory = make_memory(config)
        self.whole = AccumulatedMap(config.grid.cell_m)
        self.ground = GroundHeight(config.results.ground_cell_m)


def make_memory(config: Config) -> Memory:
    """The memory of the section grid."""
    grid = config.grid

    def lattice(layers: dict) -> Layers:
        return SlidingLattice(layers) if grid.extent == "window" else GrowingLattice(grid.cell_m, layers)

    if grid.memory == "scan":
        return ScanMemory()
    if grid.memory == "decay":
        return DecayMemory(lattice(DecayMemory.LAYERS), grid.decay_s)
    return LogOddsMemory(lattice(LogOddsMemory.LAYERS), grid.clear_s)


def _begin(walk: ReplayContext) -> Scanner:
    """The scanner of the pass over the recording."""
    assert walk.scanner is not None
    walk.use("lidar")
    walk.progress.begin("filter", len(walk.scanner.spill))
    if not walk.lidar_mount_known:
        walk.warn("lidar.mount is neither configured nor in tf: the lidar is taken to sit in base, looking forward")
    return walk.scanner


def _filtered(walk: ReplayContext, scanner: Scanner, poses: ScanPoses) -> Iterator[tuple[ScanRow, ScanPlace]]:
    """Every scan with its place, except those that a clock set back stamps a second time; writes its row."""
    scans = map(ScanRow.from_bytes, compress(scanner.spill, ~walk.streams.repeated_clouds))
    with TableWriter(walk.run.path / "scans.parquet", TABLES["scans"]) as table:
        while rows := list(islice(scans, AT_ONCE)):
            for row, place in zip(rows, poses.of(rows), strict=True):
                walk.first_ns, walk.last_ns = min(walk.first_ns, row.t_ns), max(walk.last_ns, row.t_ns)
                table.add_row(_columns(row))
                _count_scan(walk, row)
                yield row, place
                walk.progress.advance((row.t_ns - walk.first_ns) * 1e-9)


def _end(walk: ReplayContext, scanner: Scanner, poses: ScanPoses) -> None:
    samples = list(scanner.samples.kept())
    walk.run.write("cloud_samples", _samples(samples, [poses.at(each.t_ns, each.slot_ns) for each in samples]))
    _tell_routes(walk, scanner, poses.skewed)
    _tell_of_scans(walk)


def _count_scan(walk: ReplayContext, row: ScanRow) -> None:
    walk.count("scans")
    if row.shows_nothing:
        walk.count("scans_without_points")
    elif not row.ground_found:
        walk.count("scans_without_ground")
    elif not is_level(row.ground):
        walk.count("scans_with_steep_ground")


def _tell_routes(walk: ReplayContext, scanner: Scanner, skewed: Counter[Skewed]) -> None:
    """Notes on the classification, and warnings of scans that were not deskewed or levelled."""
    routes, tilted = scanner.tally.routes, scanner.tally.tilted
    scans = walk.counts.get("scans", 0)
    for route, count in routes.most_common():
        walk.note(f"{count} of {routes.total()} scans classified {ROUTE_WORDS[route]}")
    for reason, count in skewed.items():
        walk.count("scans_not_deskewed", count)
        if reason is not Skewed.NO_TIMES and walk.config.lidar.deskew:
            walk.warn(f"{count} of {scans} scans keep the robot's motion: {reason.value}")
    for why_not, count in tilted.items():
        walk.count("scans_not_levelled", count)
        walk.warn(f"{count} of {scans} scans keep the robot's tilt: {why_not.value}")


def _tell_of_scans(walk: ReplayContext) -> None:
    """A warning for each kind of unusual scans."""
    said = {
        "scans_without_points": f"fewer than {FEWEST_RETURNS} points on the ground or on obstacles; they are in no map",
        "scans_without_ground": "no ground is found, as in a 2-D scan; heights are those above base's own floor",
        "scans_with_steep_ground": "the plane taken for the ground is too steep to be one, probably a wall; what lies "
        "in it is not in those maps",
    }
    for name, text in said.items():
        if count := walk.counts.get(name, 0):
            n = walk.counts["scans"]
            _, why = walk.roles.of_topic(walk.lidar_topic())
            walk.warn(f"{count} of {n} scans: {text}" + (f" ({walk.lidar_topic()}: {why})" if count == n else ""))


def _map_scan(walk: ReplayContext, row: ScanRow, place: ScanPlace, maps: MapsWriter, mapper: _Mapper) -> None:
    if row.shows_nothing:
        return
    if not np.isfinite(place.pose).all():
        walk.count("scans_without_pose")
        return
    grid = walk.config.grid
    scan, window = CompactScan.from_bytes(row.compact), window_around(place.pose[:2], grid.cell_m, grid.size_cells)
    placed = mapper.placer.place(scan, place.slot_pose, place.target_m, window)
    maps.append(row.t_ns, window.origin_m, mapper.memory.add(row.t_ns, window, placed))
    # An obstacle lower than the robot blocks, even if rays pass above it.
    mapper.whole.add(window, placed, round(walk.config.robot.height_m * 1000))
    # A wall taken for the ground says nothing about the height of the floor.
    if scan.level:
        mapper.ground.add(scan, place.slot_pose)


def _write_maps(walk: ReplayContext, mapper: _Mapper) -> None:
    whole = mapper.whole.to_cells()
    if whole is not None:
        cells, window = whole
        write_rosmap(walk.run.path, cells, window.origin_m, window.cell_m)
    ground = mapper.ground.to_map()
    if ground is not None:
        walk.run.write("ground", {key: getattr(ground, key) for key in ARRAYS["ground"]})
    for name, skipped in (("map.pgm", mapper.whole.skipped), ("ground.npz", mapper.ground.skipped)):
        if skipped:
            walk.warn(f"{name}: {skipped} scans left out, the run covers more ground than the file may grow to")
    if mapper.memory.skipped:
        walk.warn(f"{mapper.memory.skipped} maps hold one scan alone: the run covers more than memory may grow to")
    lost = walk.counts.get("scans_without_pose", 0)
    if lost:
        walk.warn(f"{lost} scans are not in the map: no pose within {walk.config.lidar.pose_gap_s} s of them")


def _columns(row: ScanRow) -> dict[str, float | int | bool]:
    normal_x, normal_y, normal_z = row.normal
    names = ("t_ns", "n_raw", "n_valid", "n_outlier", "n_ground", "n_obstacle", "ground_found", "ms")
    values: dict[str, float | int | bool] = {name: getattr(row, name) for name in names}
    return values | {"ground_nx": normal_x, "ground_ny": normal_y, "ground_nz": normal_z, "ground_d_m": row.d_m}


def _samples(scans: Sequence[WholeScan], poses: Sequence[tuple[Float, Float]]) -> dict[str, Any]:
    """The arrays of `cloud_samples.npz`. poses: in map at each scan's instant (3,), and at its slots."""
    xyz_m = [
        scan.xyz_m if np.isnan(pose).any() else deskewed(scan.xyz_m, scan.slot, pose, slot_pose)
        for scan, (pose, slot_pose) in zip(scans, poses, strict=True)
    ]
    pose_at = np.array([pose for pose, _ in poses], np.float64).reshape(-1, 3)
    return {
        "t_ns": [scan.t_ns for scan in scans],
        "offset": np.cumsum([0, *map(len, xyz_m)], dtype=np.int64),
        "xyz_m": np.concatenate([np.empty((0, 3), np.float32), *xyz_m], dtype=np.float32),
        "label": np.concatenate([np.empty(0, np.uint8), *(scan.label for scan in scans)], dtype=np.uint8),
        **dict(zip(("x_m", "y_m", "yaw_rad"), pose_at.T, strict=True)),
        "classes": [each.name.lower() for each in PointClass],
    }
