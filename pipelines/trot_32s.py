"""The story of `quadlog simulate trot-32s` [Foot, section 4]: for each seed, the walk without and with y(t)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from quadlog.config import Config
from quadlog.errors import AlreadyExists, ExitCode
from quadlog.pipelines.engine.cores import cores
from quadlog.pipelines.engine.side_by_side import side_by_side
from quadlog.pipelines.progress import Progress
from quadlog.pipelines.replay import ReplayOutcome
from quadlog.pipelines.simulate import SimulatedRun
from quadlog.pipelines.simulation.trot import CURVES, TrottedCurve, plan_trot, trot_once
from quadlog.pipelines.simulation.trot_folder import TrotDescription, fill_trot_folder, verdict
from quadlog.pipelines.stages.first_compilation import SAID, on_first_compilation
from quadlog.pipelines.summary import summarise
from quadlog.results.files import is_part
from quadlog.results.run_folder import RunFolder
from quadlog.simulation.courses import TROT


@dataclass(frozen=True, slots=True)
class TrotRequest:
    """seeds: one walk of each curve for each."""

    config: Config
    seeds: Sequence[int] = (0,)
    output: Path = Path("runs")
    force: bool = False
    command: tuple[str, ...] = ("quadlog", "simulate", TROT)

    def run(self, curve: str, seed: int) -> Path:
        """Where a walk goes: the curve's folder, and one below it for each seed where there are several."""
        folder = self.output / TROT / curve
        return folder if len(self.seeds) == 1 else folder / f"seed-{seed:03d}"


def trot_32s(request: TrotRequest, jobs: int | None, progress: Progress) -> list[SimulatedRun]:
    """Walk with both curves for each seed; a fall is a result. Returns the walks curve by curve, these as controllers.

    Raises AlreadyExists, and InvalidConfigValue for a curve out of reach, before anything is written.
    """
    if not request.force:
        for curve in CURVES:
            for seed in request.seeds:
                _refuse_existing(request.run(curve, seed))
    startup_s = _warm_up(request, progress)
    progress.begin("simulate", len(request.seeds))
    workers = min(jobs or cores(), len(request.seeds))
    if workers > 1:
        todo = [(request, seed) for seed in request.seeds]
        pairs = side_by_side(_walk_pair_elsewhere, todo, workers, progress)
    else:
        pairs = _one_by_one(request, startup_s, progress)
    runs = [run for curve in range(len(CURVES)) for run in (pair[curve] for pair in pairs)]
    _summarise(runs, progress)
    return runs


def _refuse_existing(run: Path) -> None:
    if run.is_dir() and not all(is_part(entry.name) for entry in run.iterdir()):
        raise AlreadyExists(run)


def _warm_up(request: TrotRequest, progress: Progress) -> float:
    """Load and compile, here once for all workers, by what joints are sent to; returns the seconds it took."""
    started = time.perf_counter()
    with on_first_compilation(lambda: progress.say(SAID)):
        plan_trot(request.config.simulation, "3d-curve", request.seeds[0])
    return time.perf_counter() - started


def _one_by_one(request: TrotRequest, startup_s: float, progress: Progress) -> list[list[SimulatedRun]]:
    pairs = []
    for seed in request.seeds:
        pairs.append(_walk_pair(request, seed, startup_s, progress))
        progress.advance()
    return pairs


def _walk_pair(request: TrotRequest, seed: int, startup_s: float, progress: Progress) -> list[SimulatedRun]:
    """Both curves of a seed, simulated before anything is written."""
    walks = {curve: trot_once(request.config.simulation, curve, seed) for curve in CURVES}
    return [_save(request, curve, seed, walk, startup_s, progress) for curve, walk in walks.items()]


def _save(
    request: TrotRequest, curve: str, seed: int, walk: TrottedCurve, startup_s: float, progress: Progress
) -> SimulatedRun:
    description = TrotDescription(curve, request.config, seed, request.command, startup_s)
    with RunFolder.create_whole(request.run(curve, seed), request.force) as folder:
        metrics = fill_trot_folder(folder, description, walk, progress.say)
    ended = verdict(walk)
    progress.say(f"{folder.path}: {ended or 'done'}")
    return SimulatedRun(folder.path, TROT, curve, seed, ended, metrics)


def _walk_pair_elsewhere(each: tuple[TrotRequest, int], progress: Progress) -> list[SimulatedRun]:
    request, seed = each
    return _walk_pair(request, seed, 0.0, progress)


def _summarise(runs: Sequence[SimulatedRun], progress: Progress) -> None:
    """summary.parquet and report.html of the folders that hold the runs."""
    outcomes: dict[Path, list[ReplayOutcome]] = {}
    for each in runs:
        outcome = ReplayOutcome(Path(TROT), each.run, ExitCode.DONE, each.ended, each.metrics)
        outcomes.setdefault(each.run.parent, []).append(outcome)
    for folder, mine in outcomes.items():
        summarise({folder}, mine, progress)
