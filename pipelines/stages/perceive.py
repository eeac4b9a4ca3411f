"""Stages `filter` and `map`: every scan is classified, then laid on the grid around the robot, one at a time.

They share one pass over the recording, so that no more than one scan is ever
held; each is timed on its own.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

import numpy as np

from quadlog.config import Config
from quadlog.lidar.classify import FEWEST_RETURNS
from quadlog.lidar.ground import is_level
from quadlog.lidar.points import PointClass
from quadlog.lidar.returns import ClassifiedReturns
from quadlog.mapping.accumulated import AccumulatedMap
from quadlog.mapping.compact import CompactSettings, ScanCompactor, reach_of
from quadlog.mapping.ground_height import GroundHeight
from quadlog.mapping.lattice import GrowingLattice, Layers, SlidingLattice
from quadlog.mapping.memory import DecayMemory, LogOddsMemory, Memory, ScanMemory
from quadlog.mapping.obstacles import ObstacleSettings
from quadlog.mapping.placing import ScanPlacer
from quadlog.mapping.window import window_around
from quadlog.pipelines.stages.sampling import EvenSample
from quadlog.pipelines.stages.scans import Scan, Scanner, Surroundings
from quadlog.pipelines.stages.walk import Walk
from quadlog.results.maps import MapsWriter
from quadlog.results.rosmap import write_rosmap
from quadlog.results.samples import CloudSample, GroundMap, write_cloud_samples, write_ground
from quadlog.results.schemas import TABLES
from quadlog.results.tables import TableWriter


def filter_scans(walk: Walk) -> None:
    """Stage `filter` alone: scans.parquet and the cloud samples; needs no pose."""
    _warn_of_mount(walk)
    for _ in _filtered(walk):
        pass


def _warn_of_mount(walk: Walk) -> None:
    if np.array_equal(walk.transform_lidar_to_base, np.eye(4)):
        walk.warn("lidar.mount is neither configured nor in tf: the lidar is taken to sit in base, looking forward")


def filter_and_map(walk: Walk) -> None:
    """Stages `filter` and `map`: also maps.npz, map.pgm with map.yaml, and ground.npz."""
    _warn_of_mount(walk)
    grid = walk.config.grid
    built = _Built(
        make_memory(walk.config),
        AccumulatedMap(grid.cell_m),
        GroundHeight(walk.config.results.ground_cell_m),
        ScanCompactor(compact_settings(walk.config)),
        ScanPlacer(grid.min_points, grid.target_radius_m),
    )
    shape = (grid.size_cells, grid.size_cells)
    with ExitStack() as stack:
        with walk.clock.stage("map"):
            maps = stack.enter_context(MapsWriter(walk.run.path / "maps.npz", grid.cell_m, shape))
        for scan in _filtered(walk):
            with walk.clock.stage("map"):
                _map_scan(walk, scan, maps, built)
    with walk.clock.stage("map"):
        _write_built(walk, built)


@dataclass(frozen=True, slots=True)
class _Built:
    """What grows over the whole run."""

    memory: Memory
    whole: AccumulatedMap
    ground: GroundHeight
    compactor: ScanCompactor
    placer: ScanPlacer


def make_memory(config: Config) -> Memory:
    """What the configured map remembers, and where."""
    grid = config.grid

    def lattice(layers: dict) -> Layers:
        return SlidingLattice(layers) if grid.extent == "window" else GrowingLattice(grid.cell_m, layers)

    if grid.memory == "scan":
        return ScanMemory()
    if grid.memory == "decay":
        return DecayMemory(lattice(DecayMemory.LAYERS), grid.decay_s)
    return LogOddsMemory(lattice(LogOddsMemory.LAYERS), grid.clear_s)


def _scans(walk: Walk, scanner: Scanner) -> Iterator[Scan]:
    for t_ns, cloud in walk.clouds():
        started = time.perf_counter()
        returns, pose, slot_poses = scanner.classify(t_ns, cloud)
        yield Scan(t_ns, returns, pose, slot_poses, (time.perf_counter() - started) * 1e3)


def _filtered(walk: Walk) -> Iterator[Scan]:
    """Keep a row of scan after scan; the clouds themselves are gone with the next one."""
    scanner = Scanner(Surroundings.of_walk(walk))
    samples: EvenSample[CloudSample] = EvenSample(walk.config.results.cloud_samples)
    walk.progress.begin("filter", walk.expected_messages(walk.lidar_topic()))
    with TableWriter(walk.run.path / "scans.parquet", TABLES["scans"]) as table:
        for scan in walk.clock.drawn("filter", _scans(walk, scanner)):
            with walk.clock.stage("filter"):
                walk.first_ns, walk.last_ns = min(walk.first_ns, scan.t_ns), max(walk.last_ns, scan.t_ns)
                table.add_row(_row(scan))
                _count_scan(walk, scan.returns)
                samples.offer(partial(_sample, scan))
            yield scan
            walk.progress.advance((scan.t_ns - walk.first_ns) * 1e-9)
    with walk.clock.stage("filter"):
        write_cloud_samples(walk.run.path, samples.kept(), [each.name.lower() for each in PointClass])
    scanner.tally.tell(walk)
    _tell_of_scans(walk)


def _count_scan(walk: Walk, points: ClassifiedReturns) -> None:
    walk.count("scans")
    if points.shows_nothing:
        walk.count("scans_without_points")
    elif points.ground is None:
        walk.count("scans_without_ground")
    elif not is_level(points.ground):
        walk.count("scans_with_steep_ground")


def _tell_of_scans(walk: Walk) -> None:
    """What was odd about some of the scans, a line for each kind."""
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


def _map_scan(walk: Walk, scan: Scan, maps: MapsWriter, built: _Built) -> None:
    if scan.returns.shows_nothing:
        return
    if scan.pose_base_in_map is None:
        walk.count("scans_without_pose")
        return
    grid, pose = walk.config.grid, scan.pose_base_in_map
    window = window_around(pose[:2], grid.cell_m, grid.size_cells)
    compact = built.compactor.compact(scan.returns, scan.t_ns)
    placed = built.placer.place(compact, scan.slot_poses, walk.target_at(scan.t_ns), window)
    maps.append(scan.t_ns, window.origin_m, built.memory.add(scan.t_ns, window, placed))
    # What a ray passes above the robot's back may still be in its way.
    built.whole.add(window, placed, round(walk.config.robot.height_m * 1000))
    # A wall that was taken for the ground says nothing about where the floor is.
    if compact.level:
        built.ground.add(compact, scan.slot_poses)


def _write_built(walk: Walk, built: _Built) -> None:
    whole = built.whole.to_cells()
    if whole is not None:
        cells, window = whole
        write_rosmap(walk.run.path, cells, window.origin_m, window.cell_m)
    ground = built.ground.to_map()
    if ground is not None:
        write_ground(
            walk.run.path, GroundMap(ground.origin_m, ground.cell_m, ground.height_m, ground.count.astype(np.int64))
        )
    for name, skipped in (("map.pgm", built.whole.skipped), ("ground.npz", built.ground.skipped)):
        if skipped:
            walk.warn(f"{name}: {skipped} scans left out, the run covers more ground than the file may grow to")
    if built.memory.skipped:
        walk.warn(f"{built.memory.skipped} maps hold one scan alone: the run covers more than memory may grow to")
    lost = walk.counts.get("scans_without_pose", 0)
    if lost:
        walk.warn(f"{lost} scans are not in the map: no pose within {walk.config.lidar.pose_gap_s} s of them")


def _row(scan: Scan) -> dict[str, float | int | bool]:
    points, ground = scan.returns, scan.returns.ground
    normal = (np.nan, np.nan, np.nan) if ground is None else ground.normal
    return {
        "t_ns": scan.t_ns,
        "n_raw": points.n_raw,
        "n_valid": points.n_valid,
        "n_outlier": points.n_outlier,
        "n_ground": points.n_ground,
        "n_obstacle": points.n_obstacle,
        "ground_nx": float(normal[0]),
        "ground_ny": float(normal[1]),
        "ground_nz": float(normal[2]),
        "ground_d_m": np.nan if ground is None else ground.d_m,
        "ground_found": ground is not None,
        "ms": scan.ms,
    }


def _sample(scan: Scan) -> CloudSample:
    x_m, y_m, yaw_rad = (np.nan, np.nan, np.nan) if scan.pose_base_in_map is None else scan.pose_base_in_map
    points = scan.returns.points()
    valid = points.label != PointClass.INVALID
    xyz_m = points.xyz_base_m[valid].astype(np.float32)
    return CloudSample(scan.t_ns, xyz_m, points.label[valid], float(x_m), float(y_m), float(yaw_rad))


def compact_settings(config: Config) -> CompactSettings:
    """What maps of this configuration need of a scan."""
    grid, robot = config.grid, config.robot
    blocking = ObstacleSettings(
        min_height_m=grid.min_height_m,
        max_height_m=grid.max_height_m,
        body_length_m=robot.length_m,
        body_width_m=robot.width_m,
    )
    return CompactSettings(
        blocking,
        reach_m=min(reach_of(grid.cell_m, grid.size_cells), config.lidar.max_range_m),
        highest_m=max(grid.max_height_m, robot.height_m) + 0.1,
        ground_cell_m=config.results.ground_cell_m,
        counts=grid.min_points > 1,
    )
