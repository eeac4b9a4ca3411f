"""Planning problems and where they come from: forests, benchmark and ROS maps, runs, recordings; and options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.errors import MissingInput, UsageError
from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.mapping.grid import Window, window_at
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.plan import growth_of, recorded_maps
from quadlog.pipelines.stages.tracks import RobotTrack, TargetTrack
from quadlog.planning.protocol import Bool, Cell
from quadlog.planning.query import Growth, NoQuery, Query, make_query
from quadlog.planning.registry import make_planner, planner_names, planner_type
from quadlog.planning.rules import Rules
from quadlog.recordings.find import find_recordings
from quadlog.results.arrays import load_maps
from quadlog.results.find_runs import fetch_runs, is_run, run_names
from quadlog.results.tables import has_table
from quadlog.simulation.worlds.replanning_walk import WorldWalk, asked_at, walk_world
from quadlog.simulation.worlds.scenes import MOST_PER_M2, forest_world
from quadlog.simulation.worlds.world import World
from quadlog.storage.formats.movingai import ScenQuery, read_movingai_map, read_movingai_scen
from quadlog.storage.formats.ros_map import read_rosmap
from quadlog.storage.remote_path import RemotePath, to_path


class Question(NamedTuple):
    """A query at an instant."""

    t_ns: int
    query: Query | NoQuery


Episode = Iterable[Question]
Ends = tuple[Cell, Cell]


@dataclass(frozen=True, slots=True)
class ProblemSource:
    """Episodes of planning problems; within an episode they follow one another in time.

    name: as the column `source` has it; about: one sentence on what is asked.
    episodes: gives all of them on every call; count: their number.
    is_static: every question stands alone, so planners can be run one after the other, each in its own memory.
    queries: the lines of a .scen file, one episode each.
    """

    name: str
    about: str
    episodes: Callable[[], Iterator[Episode]]
    count: int
    is_static: bool = False
    queries: tuple[ScenQuery, ...] = ()


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """What decides a comparison beside its sources.

    planners: none are all. costs: None is exact with a .scen file, else integer. counted, leader: None is the preset's.
    scen, start_cell, goal_cell: for maps in files. config: of a run folder it replaces what is given here.
    """

    planners: tuple[str, ...] = ()
    preset: str = "honest"
    costs: str | None = None
    ties: str = "larger_g"
    counted: str | None = None
    leader: str | None = None
    corner_cutting: bool = False
    scen: Path | None = None
    start_cell: tuple[int, int] | None = None
    goal_cell: tuple[int, int] | None = None
    episodes: int = 40
    seed: int = 0
    config: Config = field(default_factory=Config)

    @property
    def ends(self) -> Ends | None:
        """Start and goal, where both are given."""
        return None if self.start_cell is None or self.goal_cell is None else (self.start_cell, self.goal_cell)

    @property
    def rules(self) -> Rules:
        """What planners are made with: each keeps the rule it is defined by."""
        heuristic = "manhattan" if self.preset == "paper" else "octile"
        costs = self.costs or ("exact" if self.scen is not None else "integer")
        return Rules(costs, heuristic, self.ties, self.corner_cutting)

    @property
    def baseline(self) -> str:
        """What every planner's cells are compared with."""
        return "astar_paper" if self.preset == "paper" else "astar"

    @property
    def walked_by(self) -> str:
        """Whose plans are walked through forests; the paper's robot follows IA*'s. Raises as planner_type does."""
        leader = self.leader or ("ia_star" if self.preset == "paper" else "astar")
        planner_type(leader)
        return leader

    @property
    def names(self) -> tuple[str, ...]:
        """The planners to run, the baseline first. Raises as planner_type does."""
        names = tuple(dict.fromkeys([self.baseline, *(self.planners or planner_names())]))
        for name in names:
            planner_type(name)
        return names

    @property
    def counts(self) -> str:
        """What counts as a searched cell in the ratio."""
        return self.counted or ("generated" if self.preset == "paper" else "expanded")


PREFIX = "forest:"


def forest_source(name: str, episodes: int, leader: str, rules: Rules, dilation: str, seed: int) -> ProblemSource:
    """Walks through `name`, as forest:0.2 for 0.2 trees/m²; every planner is asked what the leader was asked.

    dilation: of `goal_projection.INFLATIONS`. Raises UsageError for a density that is none.
    """
    try:
        density_per_m2 = float(name.removeprefix(PREFIX))
    except ValueError:
        density_per_m2 = -1.0
    if not 0 <= density_per_m2 <= MOST_PER_M2:
        raise UsageError(f"{name}: trees per m² between 0 and {MOST_PER_M2:g}, as in  forest:0.2")

    def walks() -> Iterator[Episode]:
        for number in range(episodes):
            rng = np.random.default_rng([seed, number, *b"planning forest"])
            world = forest_world(density_per_m2, rng, dilation=dilation)
            yield questions_along(world, walk_world(world, make_planner(leader, rules)))

    about = (
        f"simulated walks of 15 to 25 m through {density_per_m2:g} trees/m², led by {leader} one cell a replan, window "
        f"40 by 40 cells of 0.1 m, obstacles grown by 0.3 m ({dilation}), seed {seed}"
    )
    return ProblemSource(name, about, walks, episodes)


def questions_along(world: World, walk: WorldWalk) -> Iterator[Question]:
    """What was to be planned at each instant of a walk through a world."""
    for instant in walk.instants:
        yield Question(instant.t_ns, asked_at(instant, world))


NO_CELLS = np.empty((0, 2), dtype=np.int32)


def movingai_source(path: Path, name: str, scen: Path | None, ends: Ends | None) -> ProblemSource:
    """A .map taken raw, its cells 1 m wide: an episode for each line of the .scen, or one from start to goal.

    Raises UnreadableFile, TooLarge, and UsageError when there is nothing to ask.
    """
    blocked = read_movingai_map(path)
    rows, cols = blocked.shape
    window = Window(0, 0, 1.0, (rows, cols))
    about = f"a map of {cols} by {rows} cells, not grown, rows counted from the top, lengths in cells"
    if scen is None:
        return _on_map(name, f"{about}, one query", window, blocked, [_checked(name, ends, blocked.shape)])
    queries = read_movingai_scen(scen, (rows, cols))
    about = f"{about}, {len(queries)} {'query' if len(queries) == 1 else 'queries'} of {scen}"
    source = _on_map(name, about, window, blocked, [(query.start, query.goal) for query in queries])
    return replace(source, queries=tuple(queries))


def ros_map_source(path: Path, name: str, ends: Ends | None, growth: Growth) -> ProblemSource:
    """A map_server map, its obstacles grown; unknown cells are blocked, and do not grow.

    Cells count from the lower left. Raises UnreadableFile, TooLarge, and UsageError without start and goal.
    """
    ros_map = read_rosmap(path)
    unknown = ros_map.cells < 0
    blocked = INFLATIONS[growth.shape](ros_map.blocked, growth.metres / ros_map.cell_m) | unknown
    rows, cols = blocked.shape
    about = (
        f"a map of {cols} by {rows} cells of {ros_map.cell_m:g} m, obstacles grown by {growth.metres:g} m "
        f"({growth.shape}), unknown cells blocked, one query"
    )
    window = window_at(ros_map.origin_m, ros_map.cell_m, blocked.shape)
    return _on_map(name, about, window, blocked, [_checked(name, ends, blocked.shape)])


def _on_map(name: str, about: str, window: Window, blocked: Bool, asked: Sequence[Ends]) -> ProblemSource:
    """An episode for each start and goal on one map."""

    def episodes() -> Iterator[Episode]:
        for start, goal in asked:
            yield [Question(0, Query(window, blocked, start, goal, False, NO_CELLS))]

    return ProblemSource(name, about, episodes, len(asked), is_static=True)


def _checked(name: str, ends: Ends | None, shape: tuple[int, int]) -> Ends:
    """Start and goal. Raises UsageError where they are missing or outside the map."""
    if ends is None:
        other = " or --scen FILE.scen" if name.endswith(".map") else ""
        raise UsageError(f"{name}: where from and where to? Give --start-cell COL,ROW and --goal-cell COL,ROW{other}")
    rows, cols = shape
    for option, (col, row) in zip(("--start-cell", "--goal-cell"), ends, strict=True):
        if not (0 <= col < cols and 0 <= row < rows):
            raise UsageError(f"{option} {col},{row} lies outside {name}, whose cells are 0,0 to {cols - 1},{rows - 1}")
    return ends


_READ = ("run.json", "config.toml", "maps.npz", "poses.parquet", "pose_uncertainty.parquet", "target.parquet")


def run_source(run: Path, name: str, given: Mapping[str, Any] = MappingProxyType({})) -> ProblemSource:
    """One episode: the walk that the run folder holds. Raises NotARun, and MissingInput for one without a target.

    given: tables of a configuration that replace the run's own keys.
    """
    maps, config = load_maps(run), load_config(run / "config.toml", settings=given)
    if not has_table(run, "target"):
        raise MissingInput("plan", f"{run} has no target to plan to", "replay with  --set topics.target=ahead")
    robot, target = RobotTrack.read(run), TargetTrack.read(run)
    rows, cols = maps.shape
    growth = growth_of(config)

    def questions() -> Iterator[Question]:
        """One for each map at which it is known where robot and target were."""
        is_empty = True
        for instant in recorded_maps(run):
            pose = robot.pose_at(instant.t_ns, config.lidar.pose_gap_s)
            target_m = target.at(np.array([instant.t_ns]))[0]
            if pose is not None and np.isfinite(target_m).all():
                query = make_query(instant.window, instant.occupied, pose[:2], target_m, growth)
                is_empty = False
                yield Question(instant.t_ns, query)
        if is_empty:
            raise MissingInput("plan", f"{run} has no map with robot and target known", "see its poses and target")

    about = (
        f"{len(maps)} recorded maps of {cols} by {rows} cells of {maps.cell_m:g} m, obstacles grown by "
        f"{growth.metres:g} m ({growth.shape})"
    )
    return ProblemSource(name, about, lambda: iter([questions()]), 1)


def recording_source(
    recording: Path, name: str, config: Config, folder: Path, seed: int, progress: Progress
) -> tuple[ProblemSource, str]:
    """(its questions, what of it was lost); the run goes to `folder`. Raises what a replay raises."""
    request = ReplayRequest(recording, folder, config, ReplayOptions(until="map", seed=seed))
    try:
        outcome = replay(request, progress)
    except MissingInput as error:
        # Where a replay of several recordings says which one it is, and may stop before the maps.
        remedy = "planners are compared on maps, which need one" if error.stage == "filter" else error.remedy
        raise MissingInput(error.stage, f"{recording}: {error.needed}", remedy) from error
    if not has_table(folder, "target"):
        remedy = "choose one with  --set topics.target=ahead  or, for a robot that stands, fixed"
        raise MissingInput("plan", f"{recording} shows no target", remedy)
    return run_source(folder, name), outcome.reason


YAML = (".yaml", ".yml")


def open_sources(
    arguments: Sequence[str], options: CompareOptions, scratch: Path, progress: Progress
) -> tuple[list[ProblemSource], list[str]]:
    """(the sources, none twice, what of recordings was lost). Runs made of recordings go to `scratch`.

    An argument is a run folder, forest:DENSITY, a MovingAI .map, a map_server .yaml, or whatever leads to recordings,
    which come last.
    """
    _check_fit(arguments, options)
    names = list(dict.fromkeys(arguments))
    opened = {name: _open(name, options, scratch / str(number)) for number, name in enumerate(names)}
    sources = [source for source in opened.values() if source is not None]
    recordings = [name for name, source in opened.items() if source is None]
    found = find_recordings(recordings) if recordings else []
    losses = []
    for recording, run in zip(found, run_names(found), strict=True):
        asked = recording_source(recording, str(recording), options.config, scratch / run, options.seed, progress)
        sources.append(asked[0])
        losses += [asked[1]] if asked[1] else []
    return sources, losses


def _check_fit(arguments: Sequence[str], options: CompareOptions) -> None:
    """Raises UsageError for a query that no source takes."""
    if (options.start_cell is None) != (options.goal_cell is None):
        raise UsageError("--start-cell and --goal-cell go together")
    if options.scen is not None and options.ends is not None:
        raise UsageError("--scen has starts and goals of its own, without --start-cell and --goal-cell")
    if options.scen is not None and not all(name.endswith(".map") for name in arguments):
        raise UsageError("--scen FILE.scen is for MovingAI .map files")
    if options.ends is not None and not all(name.endswith((".map", *YAML)) for name in arguments):
        raise UsageError("--start-cell and --goal-cell are for MovingAI .map and ROS map_server .yaml files")


def _open(name: str, options: CompareOptions, scratch: Path) -> ProblemSource | None:
    """The source, None for what is to be looked for as a recording. A run behind a URL is copied to `scratch`."""
    path, given = to_path(name), options.config.model_dump(exclude_unset=True)
    if isinstance(path, RemotePath):
        return run_source(fetch_runs(path, scratch, _READ), str(path), given) if is_run(to_path(name)) else None
    if name.startswith(PREFIX):
        shape = "square" if options.preset == "paper" else "euclidean"
        return forest_source(name, options.episodes, options.walked_by, options.rules, shape, options.seed)
    if path.suffix == ".map":
        return movingai_source(path, name, options.scen, options.ends)
    if path.suffix in YAML:
        return ros_map_source(path, name, options.ends, growth_of(options.config))
    if (path / "run.json").is_file() or (path / "maps.npz").is_file():
        return run_source(path, name, given)
    return None
