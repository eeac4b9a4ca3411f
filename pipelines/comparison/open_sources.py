"""From what a user types to sources of questions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.errors import UsageError
from quadlog.pipelines.comparison.forest_source import PREFIX, forest_source
from quadlog.pipelines.comparison.map_source import movingai_source, ros_map_source
from quadlog.pipelines.comparison.recording_source import recording_source
from quadlog.pipelines.comparison.run_source import run_source
from quadlog.pipelines.comparison.source import Source
from quadlog.pipelines.progress import Progress
from quadlog.pipelines.stages.plan import growth_of
from quadlog.recordings.find import find_recordings
from quadlog.results.fetched_runs import fetch_runs
from quadlog.results.find_runs import is_run
from quadlog.results.names import run_names
from quadlog.storage.remote_path import RemotePath
from quadlog.storage.urls import to_path

if TYPE_CHECKING:
    from quadlog.pipelines.compare_planners import CompareOptions

YAML = (".yaml", ".yml")


def open_sources(
    arguments: Sequence[str], options: CompareOptions, scratch: Path, progress: Progress
) -> tuple[list[Source], list[str]]:
    """(the sources, none twice, what of recordings was lost). Runs made of recordings go to `scratch`.

    An argument is a run folder, forest:DENSITY, a MovingAI .map, a map_server .yaml, or whatever leads to recordings,
    which come last.
    """
    _check_fit(arguments, options)
    sources: list[Source] = []
    losses: list[str] = []
    recordings: list[str] = []
    for name in dict.fromkeys(arguments):
        source = _open(name, options, scratch / str(len(sources)))
        if source is None:
            recordings.append(name)
        else:
            sources.append(source)
    found = find_recordings(recordings) if recordings else []
    for recording, run in zip(found, run_names(found), strict=True):
        source, loss = recording_source(
            recording, str(recording), options.config, scratch / run, options.seed, progress
        )
        sources.append(source)
        losses += [loss] if loss else []
    return sources, losses


def _check_fit(arguments: Sequence[str], options: CompareOptions) -> None:
    """Raises UsageError for a query that no source takes."""
    has_cells = [cell is not None for cell in (options.start_cell, options.goal_cell)]
    if any(has_cells) != all(has_cells):
        raise UsageError("--start-cell and --goal-cell go together")
    if options.scen is not None and any(has_cells):
        raise UsageError("--scen has starts and goals of its own, without --start-cell and --goal-cell")
    if options.scen is not None and not all(name.endswith(".map") for name in arguments):
        raise UsageError("--scen FILE.scen is for MovingAI .map files")
    if any(has_cells) and not all(name.endswith((".map", *YAML)) for name in arguments):
        raise UsageError("--start-cell and --goal-cell are for MovingAI .map and ROS map_server .yaml files")


def _open(name: str, options: CompareOptions, scratch: Path) -> Source | None:
    """The source, None for what is to be looked for as a recording. A run behind a URL is copied to `scratch`."""
    ends = None
    if options.start_cell is not None and options.goal_cell is not None:
        ends = options.start_cell, options.goal_cell
    path = to_path(name)
    if isinstance(path, RemotePath):
        return run_source(fetch_runs(path, scratch), str(path)) if is_run(to_path(name)) else None
    dilation_m, dilation = growth_of(options.config)
    if name.startswith(PREFIX):
        shape = "square" if options.preset == "paper" else "euclidean"
        return forest_source(name, options.episodes, options.walked_by, options.rules, shape, options.seed)
    if path.suffix == ".map":
        return movingai_source(path, name, options.scen, ends)
    if path.suffix in YAML:
        return ros_map_source(path, name, ends, dilation_m, dilation)
    if (path / "run.json").is_file() or (path / "maps.npz").is_file():
        return run_source(path, name)
    return None
