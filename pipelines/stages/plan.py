"""Stage `plan`: at every recorded map, a path from the robot to the target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from quadlog.config.schema import Config
from quadlog.mapping.grid import window_at
from quadlog.messages import NS_PER_S, Float, Int
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.tracks import TargetTrack, Tracks
from quadlog.planning.query import Growth
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import PlannedPath, Replanner, Row
from quadlog.planning.rules import Rules
from quadlog.results.arrays import load_maps
from quadlog.results.tables import TABLES, TableWriter
from quadlog.simulation.resimulation import MapInstant


def replan(folder: Path, journal: Journal, config: Config, maps: Path, tracks: Tracks) -> None:
    """Write plans, paths and astar from the saved maps; nothing without a target, with a warning."""
    if tracks.target is None:
        journal.warn("no target: nothing is planned; set topics.target to uwb, ahead, fixed or a pose topic")
        return
    replanner = replanner_of(config, tracks.target)
    journal.progress.begin("plan", len(load_maps(maps)))
    first_ns = None
    with (
        journal.clock.stage("plan"),
        plan_tables(folder, "plans", "paths") as add,
        TableWriter(folder / "astar.parquet", TABLES["astar"]) as astar,
    ):
        for instant in recorded_maps(maps):
            first_ns = instant.t_ns if first_ns is None else first_ns
            pose = tracks.robot.pose_at(instant.t_ns, config.lidar.pose_gap_s)
            target_m = tracks.target.at(np.array([instant.t_ns]))[0]
            if pose is None or not np.isfinite(target_m).all():
                journal.count("maps_without_target")
                continue
            plan = replanner.replan(instant.t_ns, instant.window, instant.occupied, pose[:2], target_m)
            add(plan.row, plan.path)
            astar.add_row({"t_ns": instant.t_ns, "expanded": plan.astar_expanded})
            journal.progress.advance((instant.t_ns - first_ns) / NS_PER_S)
    if lost := journal.counts.get("maps_without_target", 0):
        journal.warn(
            f"{lost} maps are not planned on: no target or no position of the robot is known at their instants"
        )


@contextmanager
def plan_tables(run: Path, plans: str, paths: str) -> Iterator[Callable[[Row, PlannedPath | None], None]]:
    """A table of replans and one of their paths; yields a function that adds a row and its path if any."""
    with (
        TableWriter(run / f"{plans}.parquet", TABLES[plans]) as replans,
        TableWriter(run / f"{paths}.parquet", TABLES[paths]) as found,
    ):
        waiting: list[PlannedPath] = []

        def add(row: Row, path: PlannedPath | None) -> None:
            replans.add_row(row)
            if path is not None:
                waiting.append(path)
            if len(waiting) == PATHS_AT_ONCE:
                found.append(_columns(waiting))
                waiting.clear()

        yield add
        if waiting:
            found.append(_columns(waiting))


PATHS_AT_ONCE = 64
"""To add one at a time takes ten times as long."""


def _columns(planned: Sequence[PlannedPath]) -> dict[str, Float | Int]:
    """The rows of paths one after the other."""
    lengths = [len(each.raw_xy_m) for each in planned]
    x_m, y_m = np.concatenate([each.raw_xy_m for each in planned]).T
    smooth_x_m, smooth_y_m = np.concatenate([each.smooth_xy_m for each in planned]).T
    t_ns, i = np.repeat([each.t_ns for each in planned], lengths), np.concatenate([*map(np.arange, lengths)])
    return {"t_ns": t_ns, "i": i, "x_m": x_m, "y_m": y_m, "smooth_x_m": smooth_x_m, "smooth_y_m": smooth_y_m}


def recorded_maps(run: Path) -> Iterator[MapInstant]:
    """The saved map sequence as windows of map's lattice, in time order."""
    maps = load_maps(run)
    for index in np.argsort(maps.t_ns, kind="stable"):
        window = window_at(maps.origin_m[index], maps.cell_m, maps.shape)
        yield MapInstant(int(maps.t_ns[index]), window, maps.occupied(int(index)))


def replanner_of(config: Config, target: TargetTrack) -> Replanner:
    """Plans to a target by the sections planner, grid and smoothing."""
    planner = make_planner(config.planner.name, Rules(corner_cutting=config.planner.corner_cutting))
    stop_short_m = config.planner.stop_short_m if target.has_body else 0.0
    return Replanner(planner, growth_of(config), stop_short_m, config.smoothing)


def growth_of(config: Config) -> Growth:
    """How obstacles grow by the section grid."""
    if config.grid.dilation == "body":
        return Growth(math.hypot(*config.robot.body_m[:2]) / 2)
    return Growth(config.grid.dilation_m, config.grid.dilation)
