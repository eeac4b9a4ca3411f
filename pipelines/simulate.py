"""`quadlog simulate` as a library: a course or a trot on the spot, walked once for each seed into run folders."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from quadlog.config.controllers import CONTROLLERS, NO_CONTROLLER
from quadlog.config.schema import Config
from quadlog.errors import AlreadyExists, UsageError
from quadlog.pipelines.batch.summary import summarise
from quadlog.pipelines.executor.compilation import SAID, on_first_compilation
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import side_by_side
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.simulation.courses import Remarks, find_course, ground_remarks, make_ground
from quadlog.pipelines.simulation.run_folder import (
    TrotDescription,
    WalkDescription,
    fill_folder,
    fill_trot_folder,
    trot_verdict,
    walk_verdict,
)
from quadlog.pipelines.simulation.trot import CURVES, TrottedCurve, plan_trot, trot_once
from quadlog.pipelines.simulation.walk import check_rate, walk_once, warm_up
from quadlog.results.places import new_run
from quadlog.simulation.course_walk import TROT, Course
from quadlog.simulation.robot.disturbances import DISTURBED
from quadlog.storage.atomic_write import is_part

DISTURBED_OVERRIDES = tuple(
    f"simulation.disturbances.{name}={getattr(DISTURBED, name)!r}" for name in DISTURBED.__dataclass_fields__
)
"""What --disturbed is short for, as --set takes it."""
Task = TypeVar("Task")
Walked = TypeVar("Walked")


@dataclass(frozen=True, slots=True)
class SimulateRequest:
    """course: a name or a file; TROT for trot_32s. seeds: of the walks, one each. plots: in plots/, beside the page."""

    course: str
    config: Config
    seeds: Sequence[int] = (0,)
    output: Path = Path("runs")
    force: bool = False
    command: tuple[str, ...] = ("quadlog", "simulate")
    plots: bool = True


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """One walk: its folder, how it ended where it did not arrive, and its metrics as saved."""

    run: Path
    course: str
    controller: str
    seed: int
    ended: str
    metrics: dict[str, dict[str, Any]]

    def to_dict(self) -> dict[str, Any]:
        """One flat object: which walk, and the metrics as plain numbers."""
        values = {name: metric["value"] for name, metric in self.metrics.items()}
        which = {"run": str(self.run), "course": self.course, "controller": self.controller, "seed": self.seed}
        return which | values


@dataclass(frozen=True, slots=True)
class _Seed:
    """What one walk needs, in this process or in another."""

    request: SimulateRequest
    course: Course
    config: Config
    remarks: Remarks
    seed: int
    run: Path


def simulate(request: SimulateRequest, jobs: int | None, progress: Progress) -> list[SimulatedRun]:
    """Walk the course once for each seed; a fall is a result. Returns the walks in the order of the seeds.

    Raises UsageError, AlreadyExists and what the course, the ground and the robot raise, before anything is walked.
    """
    controller = request.config.simulation.controller
    if controller == NO_CONTROLLER:
        raise UsageError(f"there is nothing to simulate without a controller; use --controller {'|'.join(CONTROLLERS)}")
    check_rate(request.config.pursuit.rate_hz)
    course = find_course(request.course, request.config)
    pursuit = request.config.pursuit.model_copy(update={"speed_mps": course.speed_mps})
    config = request.config.model_copy(update={"pursuit": pursuit})
    folder = request.output / f"{course.name}-{controller}"
    remarks = ground_remarks(course, config)
    todo = [_Seed(request, course, config, remarks, seed, folder / f"seed-{seed:03d}") for seed in request.seeds]
    _refuse_existing(request, (each.run for each in todo))
    if any(each.run.resolve() == Path(config.simulation.terrain).resolve() for each in todo):
        raise UsageError(f"{config.simulation.terrain} cannot be the terrain of the walk that replaces it")
    for warning in remarks.warnings:
        progress.say(f"warning: {warning}")
    progress.begin("simulate", len(todo))
    workers = min(jobs or cores(), len(todo))
    # Compiled once, here: workers find it in the cache. What is wrong with robot or ground shows here, too.
    startup_s = _warm_up(todo[0], progress)
    if workers == 1:
        runs = _one_by_one(lambda each: _walk(each, startup_s, progress), todo, progress)
    else:
        runs = side_by_side(_walk_elsewhere, todo, workers, progress)
    _summarise(runs, progress)
    return runs


def _refuse_existing(request: SimulateRequest, runs: Iterable[Path]) -> None:
    for run in () if request.force else runs:
        if run.is_dir() and not all(is_part(entry.name) for entry in run.iterdir()):
            raise AlreadyExists(run)


def _one_by_one(walk: Callable[[Task], Walked], todo: Iterable[Task], progress: Progress) -> list[Walked]:
    walked = []
    for each in todo:
        walked.append(walk(each))
        progress.advance()
    return walked


def _walk(each: _Seed, startup_s: float, progress: Progress) -> SimulatedRun:
    """One seed from its ground to its folder."""
    ground = make_ground(each.request.course, each.course, each.config, each.seed)
    simulated = walk_once(each.course, each.config, ground, each.seed)
    request = each.request
    made_by = each.seed, request.command, startup_s, request.plots
    description = WalkDescription(request.course, each.course, ground, each.remarks, each.config, *made_by)
    with new_run(each.run, request.force) as folder:
        metrics = fill_folder(folder, description, simulated)
    ended = walk_verdict(simulated)
    progress.say(f"{each.run}: {ended or 'done'}")
    return SimulatedRun(each.run, each.course.name, each.config.simulation.controller, each.seed, ended, metrics)


def _warm_up(each: _Seed, progress: Progress) -> float:
    ground = make_ground(each.request.course, each.course, each.config, each.seed)
    return warm_up(each.course, each.config, ground, progress.say)


def _walk_elsewhere(each: _Seed, progress: Progress) -> SimulatedRun:
    return _walk(each, _warm_up(each, progress), progress)


def trot_32s(request: SimulateRequest, jobs: int | None, progress: Progress) -> list[SimulatedRun]:
    """Walk with both curves for each seed; a fall is a result. Returns the walks curve by curve, these as controllers.

    Raises AlreadyExists, and InvalidConfigValue for a curve out of reach, before anything is written.
    """
    _refuse_existing(request, (_trot_folder(request, curve, seed) for curve in CURVES for seed in request.seeds))
    startup_s = _warm_up_trot(request, progress)
    progress.begin("simulate", len(request.seeds))
    workers = min(jobs or cores(), len(request.seeds))
    if workers > 1:
        todo = [(request, seed) for seed in request.seeds]
        pairs = side_by_side(_walk_pair_elsewhere, todo, workers, progress)
    else:
        pairs = _one_by_one(lambda seed: _walk_pair(request, seed, startup_s, progress), request.seeds, progress)
    runs = [run for curve in range(len(CURVES)) for run in (pair[curve] for pair in pairs)]
    _summarise(runs, progress)
    return runs


def _trot_folder(request: SimulateRequest, curve: str, seed: int) -> Path:
    """The curve's folder, and one below it for each seed where there are several."""
    folder = request.output / TROT / curve
    return folder if len(request.seeds) == 1 else folder / f"seed-{seed:03d}"


def _warm_up_trot(request: SimulateRequest, progress: Progress) -> float:
    """Load and compile, here once for all workers, by what joints are sent to; returns the seconds it took."""
    started = time.perf_counter()
    with on_first_compilation(lambda: progress.say(SAID)):
        plan_trot(request.config.simulation, "3d-curve", request.seeds[0])
    return time.perf_counter() - started


def _walk_pair(request: SimulateRequest, seed: int, startup_s: float, progress: Progress) -> list[SimulatedRun]:
    """Both curves of a seed, simulated before anything is written."""
    walks = {curve: trot_once(request.config.simulation, curve, seed) for curve in CURVES}
    return [_save(request, curve, seed, walk, startup_s, progress) for curve, walk in walks.items()]


def _save(
    request: SimulateRequest, curve: str, seed: int, walk: TrottedCurve, startup_s: float, progress: Progress
) -> SimulatedRun:
    description = TrotDescription(curve, request.config, seed, request.command, startup_s, request.plots)
    run = _trot_folder(request, curve, seed)
    with new_run(run, request.force) as folder:
        metrics = fill_trot_folder(folder, description, walk)
    ended = trot_verdict(walk)
    progress.say(f"{run}: {ended or 'done'}")
    return SimulatedRun(run, TROT, curve, seed, ended, metrics)


def _walk_pair_elsewhere(each: tuple[SimulateRequest, int], progress: Progress) -> list[SimulatedRun]:
    request, seed = each
    return _walk_pair(request, seed, 0.0, progress)


def _summarise(runs: Sequence[SimulatedRun], progress: Progress) -> None:
    """summary.parquet and report.html of the folders that hold the runs."""
    for folder in dict.fromkeys(each.run.parent for each in runs):
        summarise(folder, progress)
