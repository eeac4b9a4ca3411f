"""The run folder of a simulated walk, along a course or a trot: tables, metrics, plots and page; `run.json` last."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.metrics.metric import Metric, Metrics, saved_metrics
from quadlog.metrics.walking import GRAVITY_MPS2, TrackedWalk, effort_metrics, tracking_metrics
from quadlog.pipelines.executor.progress import StageClock, peak_memory_mb
from quadlog.pipelines.simulation.courses import LEAST_POINTS, Remarks
from quadlog.pipelines.simulation.trot import TrottedCurve, trot_metrics
from quadlog.pipelines.simulation.walk import SimulatedWalk
from quadlog.results.figures import drawings_of, write_plots
from quadlog.results.foxglove import write_derived, write_layout
from quadlog.results.page.run_page import write_run_page
from quadlog.results.record import InputRecord, RunRecord, StageRecord, describe_input
from quadlog.results.run import Run
from quadlog.results.tables import TABLES
from quadlog.simulation.course_walk import COURSES, TROT, Course
from quadlog.simulation.robot.height_field import HeightField
from quadlog.simulation.robot.model import TIMESTEP_S
from quadlog.storage.formats.tum import write_tum
from quadlog.version import __version__

NS = 1_000_000_000
SavedMetrics = dict[str, dict[str, Any]]


@dataclass(frozen=True, slots=True)
class TrotDescription:
    """What was simulated; startup_s: what loading and compiling took before."""

    curve: str
    config: Config
    seed: int
    command: tuple[str, ...]
    startup_s: float
    plots: bool = True


def fill_trot_folder(folder: Path, description: TrotDescription, trotted: TrottedCurve) -> SavedMetrics:
    """Write everything about a walk, and return its metrics as saved."""
    walk, clock = trotted.walk, StageClock()

    def write_results(run: Run) -> None:
        control = dict.fromkeys(TABLES["control"].names, np.full(len(walk.t_ns), np.nan)) | walk.columns()
        run.write("control", control)
        _write_trajectory(run, control)

    record = partial(_trot_record, description, trotted, clock)
    return _fill(folder, description, trot_metrics(trotted), write_results, clock, record)


def _fill(
    folder: Path,
    description: TrotDescription | WalkDescription,
    metrics: Metrics,
    write_results: Callable[[Run], None],
    clock: StageClock,
    record: Callable[[], RunRecord],
) -> SavedMetrics:
    """Write config, metrics and results, then plots and the page on them; `run.json` last."""
    saved = saved_metrics(metrics)
    with clock.stage("report"):
        run = Run.create(folder, record())
        run.write("metrics", saved)
        write_results(run)
        drawings = drawings_of(Run(folder, record()))
        if description.plots:
            write_plots(folder, drawings)
    finished = record()
    write_run_page(Run(folder, finished), drawings)
    run.finish(finished)
    return saved


def _write_trajectory(run: Run, control: Mapping[str, Any]) -> None:
    tilt_rad = np.column_stack([control["roll_rad"], control["pitch_rad"]])
    t_ns, x_m, y_m, yaw_rad, z_m = (control[name] for name in ("t_ns", "x_m", "y_m", "yaw_rad", "z_m"))
    write_tum(run.path / "trajectory.tum", t_ns, x_m, y_m, yaw_rad, z_m, tilt_rad)


def _stages(seconds: float, clock: StageClock) -> list[StageRecord]:
    """Walking, and what was written since."""
    peaks_mb = {"control": peak_memory_mb(), "report": clock.peak_memory_mb.get("report", 0.0)}
    spent_s = {"control": seconds, "report": clock.seconds.get("report", 0.0)}
    return [StageRecord(name=name, seconds=spent_s[name], peak_memory_mb=peaks_mb[name]) for name in peaks_mb]


def trot_verdict(trotted: TrottedCurve) -> str:
    """That and when the robot fell; empty if it did not."""
    fallen = trotted.walk.fallen
    return f"fell after {trotted.walk.t_ns[np.argmax(fallen)] / NS:.2f} s" if fallen.any() else ""


def _record(
    description: TrotDescription | WalkDescription,
    clock: StageClock,
    lasted_s: float,
    walking_s: float,
    course: str,
    controller: str,
    **own: Any,
) -> RunRecord:
    """What both kinds of walks say of themselves; own: the other fields."""
    return RunRecord(
        quadlog_version=__version__,
        command=list(description.command),
        config=description.config,
        options={"course": course, "controller": controller, "seed": description.seed},
        seed=description.seed,
        recorded_s=lasted_s,
        stages=_stages(walking_s, clock),
        startup_s=description.startup_s,
        realtime_factor=lasted_s / walking_s,
        **own,
    )


def _trot_record(description: TrotDescription, trotted: TrottedCurve, clock: StageClock) -> RunRecord:
    walk, robot = trotted.walk, trotted.planned.robot
    # The joint angles that the robot is sent to.
    targets = trotted.planned.targets_rad.tobytes()
    return _record(
        *(description, clock, float(walk.t_ns[-1]) / NS, trotted.seconds, TROT, description.curve),
        input=InputRecord(path=TROT, size_bytes=len(targets), sha256=hashlib.sha256(targets).hexdigest()),
        counts={"samples": len(walk.t_ns)},
        warnings=[f"the robot {ended}"] if (ended := trot_verdict(trotted)) else [],
        notes=[
            f"y(t) has a peak of {1e3 * trotted.planned.peak_m:.2f} mm",
            f"drawn: friction {robot.friction:.4f}, feet of {1e3 * robot.foot_radius_m:.2f} mm radius, and a posture",
        ],
    )


@dataclass(frozen=True, slots=True)
class WalkDescription:
    """What was simulated: course_argument is the course's name, or the file it came from."""

    course_argument: str
    course: Course
    ground: HeightField
    remarks: Remarks
    config: Config
    seed: int
    command: tuple[str, ...]
    startup_s: float
    plots: bool = True


def fill_folder(folder: Path, description: WalkDescription, simulated: SimulatedWalk) -> SavedMetrics:
    """Write everything about a walk, and return its metrics as saved."""
    clock = StageClock()
    record = partial(_walk_record, description, simulated, clock)

    def write_results(run: Run) -> None:
        _write_tables(run, description, simulated)
        results = Run(folder, record())
        write_derived(results)
        write_layout(results)

    return _fill(folder, description, walk_metrics(simulated), write_results, clock, record)


def walk_metrics(simulated: SimulatedWalk) -> Metrics:
    """How well the course was followed, what it cost, and how fast it was simulated."""
    walk = simulated.walk
    control = walk.control
    errors = {name: control[name] for name in ("error_m", "cross_track_m", "time_error_m", "heading_error_rad")}
    fallen = control["fallen"].astype(np.bool_) if simulated.model is not None else None
    metrics = tracking_metrics(TrackedWalk(control["t_ns"], **errors, fallen=fallen), walk.completed_ns)
    if walk.effort is not None:
        ticks = round(_lasted_s(simulated) / TIMESTEP_S)
        metrics |= effort_metrics(walk.mass_kg, ticks, **asdict(walk.effort))
    metrics["realtime_factor"] = Metric(_lasted_s(simulated) / simulated.seconds, 1, "")
    return metrics


def walk_verdict(simulated: SimulatedWalk) -> str:
    """How the walk ended, where it did not end at the course's end; else empty."""
    control = simulated.walk.control
    # Adding 0 makes a plain 0 of -0.
    x_m, y_m = (round(float(control[name][-1]), 2) + 0.0 for name in ("x_m", "y_m"))
    where = f"after {_lasted_s(simulated):.2f} s at ({x_m:.2f}, {y_m:.2f}) m"
    if control["fallen"][-1]:
        return f"fell {where}"
    return "" if simulated.walk.completed_ns is not None else f"gave up {where}: it should have arrived long before"


def _lasted_s(simulated: SimulatedWalk) -> float:
    t_ns = simulated.walk.control["t_ns"]
    return float(t_ns[-1] - t_ns[0]) / NS


def _write_tables(run: Run, description: WalkDescription, simulated: SimulatedWalk) -> None:
    control, path_m = simulated.walk.control, description.course.path_m
    run.write("control", control)
    # The course is the one plan of the walk.
    course = {"t_ns": np.zeros(len(path_m), np.int64), "i": np.arange(len(path_m))}
    x_m, y_m = path_m.T
    run.write("paths", course | {"x_m": x_m, "y_m": y_m, "smooth_x_m": x_m, "smooth_y_m": y_m})
    _write_trajectory(run, control)
    ground = description.ground
    if not ground.is_plane:
        # A corner's height stands for the cell about it.
        origin_m = np.array(ground.origin_m) - ground.cell_m / 2
        # It is known everywhere, so that it can be a terrain again.
        seen = np.full(ground.height_m.shape, LEAST_POINTS, np.int64)
        run.write("ground", {"origin_m": origin_m, "cell_m": ground.cell_m, "height_m": ground.height_m, "count": seen})


def _walk_record(description: WalkDescription, simulated: SimulatedWalk, clock: StageClock) -> RunRecord:
    controller = description.config.simulation.controller
    return _record(
        *(description, clock, _lasted_s(simulated), simulated.seconds, description.course_argument, controller),
        input=_walk_input(description),
        counts={"ticks": len(simulated.walk.control["t_ns"])} | simulated.counts,
        warnings=_warnings(description, simulated),
        notes=list(description.remarks.notes),
    )


def _walk_input(description: WalkDescription) -> InputRecord:
    """The file the path came from; of a course of quadlog's own, its points."""
    name = description.course_argument
    if name not in COURSES:
        return describe_input(Path(name))
    points = np.ascontiguousarray(description.course.path_m, np.float64).tobytes()
    return InputRecord(path=name, size_bytes=len(points), sha256=hashlib.sha256(points).hexdigest())


def _warnings(description: WalkDescription, simulated: SimulatedWalk) -> list[str]:
    warnings = list(description.remarks.warnings)
    if ended := walk_verdict(simulated):
        warnings.append(f"the robot {ended}")
    if simulated.failed_solves:
        warnings.append(f"{simulated.failed_solves} solves failed, and older or simpler forces had to do: see counts")
    weight_n, most_n = simulated.walk.mass_kg * GRAVITY_MPS2, description.config.mpc.f_max_n
    # Two feet carry in a trot, and have to push harder than the weight to go up.
    if weight_n > 1.5 * most_n:
        warnings.append(f"the robot weighs {weight_n:.0f} N; two feet of mpc.f_max_n = {most_n:g} N may not carry it")
    return warnings
