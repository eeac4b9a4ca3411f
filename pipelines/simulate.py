"""`quadlog simulate` as a library: a course or a trot on the spot, walked once for each seed into run folders."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
    Description,
    Walked,
    fill_folder,
    trotted_results,
    walked_results,
)
from quadlog.pipelines.simulation.trot import CURVES, plan_trot, trot_once
from quadlog.pipelines.simulation.walk import check_rate, walk_once
from quadlog.results.run import new_run
from quadlog.simulation.course_walk import TROT, Course
from quadlog.simulation.robot.disturbances import DISTURBED
from quadlog.simulation.robot.height_field import HeightField
from quadlog.storage.atomic_write import is_part

DISTURBED_OVERRIDES = tuple(
    f"simulation.disturbances.{name}={getattr(DISTURBED, name)!r}" for name in DISTURBED.__dataclass_fields__
)
"""What --disturbed is short for, as --set takes it."""


@dataclass(frozen=True, slots=True)
class SimulateRequest:
    """course: a name, TROT with both its curves, or a file. seeds: one for each walk. plots: also in plots/."""

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
class _Walk:
    """What one walk needs, in this process or another. course: None for a trot, whose curve is the controller."""

    request: SimulateRequest
    course: Course | None
    config: Config
    remarks: Remarks
    controller: str
    seed: int
    run: Path

    def warm_up(self, progress: Progress) -> float:
        """Load and compile by the plan of a trot or a tenth of a second of a walk; returns the seconds it took.

        Raises what is wrong with robot, ground or curve.
        """
        started = time.perf_counter()
        with on_first_compilation(lambda: progress.say(SAID)):
            if self.course is None:
                plan_trot(self.config.simulation, self.controller, self.seed)
            else:
                walk_once(self.course, self.config, self._ground(self.course), 0, most_s=0.1)
        return time.perf_counter() - started

    def results(self) -> Walked:
        """Simulate it."""
        if self.course is None:
            return trotted_results(trot_once(self.config.simulation, self.controller, self.seed))
        ground = self._ground(self.course)
        simulated = walk_once(self.course, self.config, ground, self.seed)
        most_n = self.config.mpc.f_max_n
        return walked_results(self.course, self.request.course, ground, self.remarks, simulated, most_n)

    def _ground(self, course: Course) -> HeightField:
        return make_ground(self.request.course, course, self.config, self.seed)


def simulate(request: SimulateRequest, jobs: int | None, progress: Progress) -> list[SimulatedRun]:
    """Walk the course once for each seed; a fall is a result. Returns the walks in the order of the seeds.

    trot-32s walks with both curves: these are the controllers, and come one after the other. Raises UsageError,
    AlreadyExists and what the course, the ground and the robot raise, before anything is walked.
    """
    walks = _trots(request) if request.course == TROT else _walks(request)
    for walk in () if request.force else walks:
        if walk.run.is_dir() and not all(is_part(entry.name) for entry in walk.run.iterdir()):
            raise AlreadyExists(walk.run)
    for warning in walks[0].remarks.warnings:
        progress.say(f"warning: {warning}")
    progress.begin("simulate", len(walks))
    # Compiled once, here: workers find it in the cache. What is wrong with robot or ground shows here, too.
    startup_s = walks[-1].warm_up(progress)
    workers = min(jobs or cores(), len(walks))
    if workers == 1:
        runs = []
        for walk in walks:
            runs.append(_save(walk, startup_s, progress))
            progress.advance()
    else:
        runs = side_by_side(_save_elsewhere, walks, workers, progress)
    for folder in dict.fromkeys(each.run.parent for each in runs):
        summarise(folder, progress)
    return runs


def _walks(request: SimulateRequest) -> list[_Walk]:
    """One along the course for each seed."""
    controller = request.config.simulation.controller
    if controller == NO_CONTROLLER:
        raise UsageError(f"there is nothing to simulate without a controller; use --controller {'|'.join(CONTROLLERS)}")
    check_rate(request.config.pursuit.rate_hz)
    course = find_course(request.course, request.config)
    pursuit = request.config.pursuit.model_copy(update={"speed_mps": course.speed_mps})
    config = request.config.model_copy(update={"pursuit": pursuit})
    folder, remarks = request.output / f"{course.name}-{controller}", ground_remarks(course, config)
    walks = [
        _Walk(request, course, config, remarks, controller, seed, folder / f"seed-{seed:03d}") for seed in request.seeds
    ]
    if any(walk.run.resolve() == Path(config.simulation.terrain).resolve() for walk in walks):
        raise UsageError(f"{config.simulation.terrain} cannot be the terrain of the walk that replaces it")
    return walks


def _trots(request: SimulateRequest) -> list[_Walk]:
    """One with each curve for each seed, in the curve's folder: below it where there are several seeds."""
    folders = {seed: f"seed-{seed:03d}" if len(request.seeds) > 1 else "" for seed in request.seeds}
    return [
        _Walk(request, None, request.config, Remarks(), curve, seed, request.output / TROT / curve / folder)
        for curve in CURVES
        for seed, folder in folders.items()
    ]


def _save(walk: _Walk, startup_s: float, progress: Progress) -> SimulatedRun:
    """Simulate one walk into its folder."""
    walked, request = walk.results(), walk.request
    made_by = walk.seed, request.command, startup_s, request.plots
    with new_run(walk.run, request.force) as folder:
        metrics = fill_folder(folder, Description(request.course, walk.controller, walk.config, *made_by), walked)
    progress.say(f"{walk.run}: {walked.ended or 'done'}")
    name = TROT if walk.course is None else walk.course.name
    return SimulatedRun(walk.run, name, walk.controller, walk.seed, walked.ended, metrics)


def _save_elsewhere(walk: _Walk, progress: Progress) -> SimulatedRun:
    return _save(walk, walk.warm_up(progress), progress)
