"""A run's recorded maps, on which the logged robot was to follow its target: the questions of its stage `plan`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quadlog.config import Config
from quadlog.config_file import load_config
from quadlog.errors import MissingInput
from quadlog.pipelines.comparison.source import Episode, Question, Source
from quadlog.pipelines.stages.plan import growth_of, recorded_maps
from quadlog.pipelines.stages.tracks import RobotTrack, TargetTrack
from quadlog.planning.query import make_query
from quadlog.results.maps import load_maps
from quadlog.results.tables import has_table, read_table


def run_source(run: Path, name: str) -> Source:
    """One episode: the walk that the run folder holds. Raises NotARun, and MissingInput for one without a target."""
    maps, config = load_maps(run), load_config(run / "config.toml", environ={})
    if not has_table(run, "target"):
        raise MissingInput("plan", f"{run} has no target to plan to", "replay with  --set topics.target=ahead")
    robot, target = _robot_of(run), _target_of(run)
    rows, cols = maps.shape
    about = f"{len(maps)} recorded maps of {cols} by {rows} cells of {maps.cell_m:g} m, obstacles grown by "
    dilation_m, shape = growth_of(config)

    def episodes() -> Iterator[Episode]:
        yield _questions(run, config, robot, target)

    return Source(name, f"{about}{dilation_m:g} m ({shape})", episodes, 1)


def _questions(run: Path, config: Config, robot: RobotTrack, target: TargetTrack) -> Iterator[Question]:
    """One for each map at which it is known where robot and target were; MissingInput where there is none."""
    dilation_m, shape = growth_of(config)
    is_empty = True
    for instant in recorded_maps(run):
        pose = robot.pose_at(instant.t_ns, config.lidar.pose_gap_s)
        target_m = target.at(np.array([instant.t_ns]))[0]
        if pose is not None and np.isfinite(target_m).all():
            query = make_query(instant.window, instant.occupied, pose[:2], target_m, dilation_m, shape)
            is_empty = False
            yield Question(instant.t_ns, query, instant.occupied)
    if is_empty:
        raise MissingInput("plan", f"{run} has no map with robot and target known", "see its poses and target")


def _robot_of(run: Path) -> RobotTrack:
    poses = read_table(run, "poses")
    return RobotTrack(
        poses["t_ns"], np.column_stack([poses["x_m"], poses["y_m"]]), poses["yaw_rad"], _source_of(poses["source"])
    )


def _target_of(run: Path) -> TargetTrack:
    target = read_table(run, "target")
    return TargetTrack(target["t_ns"], np.column_stack([target["x_m"], target["y_m"]]), _source_of(target["source"]))


def _source_of(column: np.ndarray) -> str:
    return str(column[0]) if len(column) else ""
