"""`quadlog simulate`: a course or a trot on the spot, walked once for each seed into run folders."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.config.controllers import COMMAND, CONTROLLERS, NO_CONTROLLER, controller_plugin
from quadlog.config.schema import Config
from quadlog.errors import UsageError
from quadlog.messages import Float
from quadlog.metrics.summary import Metric, Metrics, metrics_of, saved_metrics
from quadlog.metrics.walking import effort_metrics, tracking_samples
from quadlog.pipelines.batch.summary import summarise
from quadlog.pipelines.executor.compilation import SAID, on_first_compilation
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.executor.progress import Progress, StageClock, peak_memory_mb, start_up
from quadlog.pipelines.simulation import trot as trotting
from quadlog.pipelines.simulation import walk as walking
from quadlog.pipelines.simulation.courses import LEAST_POINTS, find_course, make_ground
from quadlog.results.figures import drawings_of, write_plots
from quadlog.results.find_runs import run_name
from quadlog.results.foxglove import write_foxglove
from quadlog.results.page.run_page import write_run_page
from quadlog.results.record import InputRecord, PluginRecord, RunRecord, StageRecord, describe_input
from quadlog.results.run import Run, check_place, create_run, finish_run, new_run, write_result
from quadlog.results.tables import BODY_COLUMNS, TABLES
from quadlog.simulation.course_walk import COURSES, TROT, Course
from quadlog.simulation.robot.disturbances import DISTURBED
from quadlog.simulation.settings import Simulation
from quadlog.storage.formats.tum import write_tum
from quadlog.version import __version__

DISTURBED_OVERRIDES = tuple(
    f"simulation.disturbances.{name}={value!r}" for name, value in DISTURBED.model_dump().items()
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


def simulate(request: SimulateRequest, jobs: int | None, progress: Progress) -> list[SimulatedRun]:
    """Walk the course once for each seed; a fall is a result. Returns the walks in the order of the seeds.

    trot-32s walks with both curves: these are the controllers, and come one after the other. Raises UsageError,
    AlreadyExists and what the course, the ground and the robot raise, before anything is walked.
    """
    walks = _trots(request) if request.course == TROT else _walks(request)
    for walk in walks:
        check_place(walk.run, request.force)
    progress.begin("simulate", len(walks))
    # Compiled once, here: workers find it in the cache. What is wrong with robot or ground shows here, too.
    with on_first_compilation(lambda: progress.say(SAID)):
        walks[-1].warm_up()
    workers = min(jobs or cores(), len(walks))
    if workers == 1:
        runs = [_shown(_save(walk), progress) for walk in walks]
    else:
        with LocalPool(workers) as pool:
            futures = [pool.submit(_save, walk) for walk in walks]
            for done in as_completed(futures):
                if done.exception() is None:
                    _shown(done.result(), progress)
        runs = [each.result() for each in futures]
    for folder in dict.fromkeys(each.run.parent for each in runs):
        summarise(folder, progress)
    return runs


def _shown(run: SimulatedRun, progress: Progress) -> SimulatedRun:
    progress.say(f"{run.run}: {run.ended or 'done'}")
    progress.advance()
    return run


def _walks(request: SimulateRequest) -> list[PlannedWalk]:
    """One along the course for each seed."""
    controller = request.config.simulation.controller
    if controller in (NO_CONTROLLER, COMMAND):
        lacks = "commands of a log" if controller == COMMAND else "a controller"
        raise UsageError(f"there is nothing to simulate without {lacks}; use --controller {'|'.join(CONTROLLERS)}")
    course = find_course(request.course, request.config)
    pursuit = request.config.pursuit.model_copy(update={"speed_mps": course.speed_mps})
    request = replace(request, config=request.config.model_copy(update={"pursuit": pursuit}))
    folder = request.output / f"{course.name}-{run_name(controller)}"
    walk = partial(_along_course, request, course)
    return [
        PlannedWalk(
            *(request, course.name, controller, seed, folder / f"seed-{seed:03d}"),
            warm_up=partial(walk, seed, most_s=0.1),
            walk=partial(walk, seed),
        )
        for seed in request.seeds
    ]


def _trots(request: SimulateRequest) -> list[PlannedWalk]:
    """One with each curve for each seed, in the curve's folder: below it where there are several seeds."""
    folders = {seed: f"seed-{seed:03d}" if len(request.seeds) > 1 else "" for seed in request.seeds}
    simulation = request.config.simulation
    return [
        PlannedWalk(
            *(request, TROT, curve, seed, request.output / TROT / curve / folder),
            warm_up=partial(trotting.plan_trot, simulation, curve, seed),
            walk=partial(_trot, simulation, curve, seed),
        )
        for curve in trotting.CURVES
        for seed, folder in folders.items()
    ]


def _save(walk: PlannedWalk) -> SimulatedRun:
    """Simulate one walk into its folder."""
    walked = walk.walk()
    with new_run(walk.run, walk.request.force) as folder:
        metrics = fill_folder(folder, walk, walked)
    return SimulatedRun(walk.run, walk.course, walk.controller, walk.seed, walked.ended, metrics)


NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class PlannedWalk:
    """One walk and its run folder. controller: of a trot its curve.

    warm_up loads and compiles, and raises what is wrong with robot, ground or curve.
    """

    request: SimulateRequest
    course: str
    controller: str
    seed: int
    run: Path
    warm_up: Callable[[], object]
    walk: Callable[[], Walked]


@dataclass(frozen=True, slots=True)
class Walked:
    """What a walk leaves for its folder.

    tables: columns of `control` and others, by name. ended: how, where it did not arrive. record: further fields of
    `RunRecord`.
    """

    tables: dict[str, Mapping[str, Any]]
    metrics: Metrics
    ended: str
    lasted_s: float
    walking_s: float
    record: dict[str, Any]


def fill_folder(folder: Path, planned: PlannedWalk, walked: Walked) -> dict[str, dict[str, Any]]:
    """Write all results of a walk, then plots and the page on them, `run.json` last. Returns the metrics as saved."""
    saved, clock, control = saved_metrics(walked.metrics), StageClock(), walked.tables["control"]
    with clock.stage("report"):
        record = _record(planned, walked, clock)
        run = create_run(folder, record)
        for name, columns in {"metrics": saved, **walked.tables}.items():
            write_result(run, name, columns)
        tilt_rad = np.column_stack([control["roll_rad"], control["pitch_rad"]])
        pose = {name: control[name] for name in ("t_ns", "x_m", "y_m", "yaw_rad", "z_m")}
        write_tum(folder / "trajectory.tum", **pose, tilt_rad=tilt_rad)
        results = Run(folder, record)
        if "paths" in walked.tables:
            write_foxglove(results)
        drawings = drawings_of(results)
        if planned.request.plots:
            write_plots(folder, drawings)
    finished = _record(planned, walked, clock)
    write_run_page(Run(folder, finished), drawings)
    finish_run(run, finished)
    return saved


def _record(planned: PlannedWalk, walked: Walked, clock: StageClock) -> RunRecord:
    request = planned.request
    warnings = [*walked.record["warnings"], *([f"the robot {walked.ended}"] if walked.ended else [])]
    spent_s = {"control": walked.walking_s, "report": clock.seconds.get("report", 0.0)}
    peaks_mb = {"control": peak_memory_mb(), "report": clock.peak_memory_mb.get("report", 0.0)}
    return RunRecord(
        quadlog_version=__version__,
        command=list(request.command),
        config=request.config,
        options={"course": request.course, "controller": planned.controller, "seed": planned.seed},
        seed=planned.seed,
        recorded_s=walked.lasted_s,
        stages=[StageRecord(name=name, seconds=spent_s[name], peak_memory_mb=peaks_mb[name]) for name in spent_s],
        startup_s=start_up.seconds,
        realtime_factor=walked.lasted_s / walked.walking_s,
        plugins=PluginRecord.of([] if planned.course == TROT else [controller_plugin(planned.controller)]),
        **walked.record | {"warnings": warnings},
    )


def _trot(simulation: Simulation, curve: str, seed: int) -> Walked:
    planned = trotting.plan_trot(simulation, curve, seed)
    robot = planned.robot
    model, started = trotting.trot_model(robot), time.perf_counter()
    walk = trotting.walk_trot(model, planned.targets_rad, planned.posture_rad)
    seconds, t_ns, fallen = time.perf_counter() - started, walk["t_ns"], walk["fallen"]
    lasted_s = float(t_ns[-1]) / NS
    return Walked(
        tables={"control": dict.fromkeys(TABLES["control"].names, np.full(len(t_ns), np.nan)) | walk},
        metrics=trotting.trot_metrics(walk) | {"realtime_factor": Metric(lasted_s / seconds, 1, "")},
        ended=f"fell after {t_ns[np.argmax(fallen)] / NS:.2f} s" if fallen.any() else "",
        lasted_s=lasted_s,
        walking_s=seconds,
        record={
            "input": _input(TROT, planned.targets_rad),  # the joint angles that the robot is sent to
            "counts": {"samples": len(t_ns)},
            "warnings": [],
            "notes": [
                f"y(t) has a peak of {1e3 * planned.peak_m:.2f} mm",
                f"drawn: friction {robot.friction:.4f}, feet of {1e3 * robot.foot_radius_m:.2f} mm radius, a posture",
            ],
        },
    )


def _along_course(request: SimulateRequest, course: Course, seed: int, most_s: float | None = None) -> Walked:
    name, config = request.course, request.config
    ground = make_ground(name, course, config, seed)
    simulated = walking.walk_once(course, config, ground, seed, most_s)
    control = simulated.walk.control
    # The course is the one plan of the walk.
    (x_m, y_m), n = course.path_m.T, len(course.path_m)
    path = {"x_m": x_m, "y_m": y_m, "smooth_x_m": x_m, "smooth_y_m": y_m}
    tables: dict[str, Mapping[str, Any]] = {
        "control": control,
        "paths": {"t_ns": np.zeros(n, np.int64), "i": np.arange(n)} | path,
    }
    if not ground.is_plane:
        # A corner's height stands for the cell about it.
        place = {"origin_m": np.array(ground.origin_m) - ground.cell_m / 2, "cell_m": ground.cell_m}
        seen = np.full(ground.height_m.shape, LEAST_POINTS, np.int64)
        tables["ground"] = place | {"height_m": ground.height_m, "count": seen}
    return Walked(
        tables=tables,
        metrics=walk_metrics(simulated),
        ended=walk_verdict(simulated),
        lasted_s=simulated.lasted_s,
        walking_s=simulated.seconds,
        record={
            "input": _input(name, course.path_m) if name in COURSES else describe_input(Path(name)),
            "counts": {"ticks": len(control["t_ns"])} | simulated.counts,
            "warnings": walking.walk_warnings(simulated.counts, simulated.walk.mass_kg, config.mpc.f_max_n),
            "notes": [],
        },
    )


def walk_metrics(simulated: walking.SimulatedWalk) -> Metrics:
    """How well the course was followed, what it cost, and how fast it was simulated."""
    walk = simulated.walk
    control = walk.control
    errors = ("t_ns", "error_m", "cross_track_m", "time_error_m", "heading_error_rad")
    columns = {name: control[name] for name in (*errors, *(BODY_COLUMNS if walk.effort is not None else ()))}
    metrics = metrics_of(tracking_samples(columns))
    if walk.completed_ns is not None:
        completion_s = (walk.completed_ns - int(columns["t_ns"][0])) / 1e9
        metrics["completion_time_s"] = Metric(completion_s, 1, "s")
    if walk.effort is not None:
        metrics |= effort_metrics(walk.mass_kg, simulated.ticks, walk.effort, control)
    metrics["realtime_factor"] = Metric(simulated.lasted_s / simulated.seconds, 1, "")
    return metrics


def walk_verdict(simulated: walking.SimulatedWalk) -> str:
    """How the walk ended, where it did not end at the course's end; else empty."""
    control = simulated.walk.control
    # Adding 0 makes a plain 0 of -0.
    x_m, y_m = (round(float(control[name][-1]), 2) + 0.0 for name in ("x_m", "y_m"))
    where = f"after {simulated.lasted_s:.2f} s at ({x_m:.2f}, {y_m:.2f}) m"
    if control["fallen"][-1]:
        return f"fell {where}"
    return "" if simulated.walk.completed_ns is not None else f"gave up {where}: it should have arrived long before"


def _input(name: str, values: Float) -> InputRecord:
    """What a course or trot of quadlog's own is made of."""
    content = np.ascontiguousarray(values, np.float64).tobytes()
    return InputRecord(path=name, size_bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
