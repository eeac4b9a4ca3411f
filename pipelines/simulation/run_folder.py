"""The run folder of a simulated walk, along a course or a trot: tables, metrics, plots and page; `run.json` last."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.messages import Float
from quadlog.metrics.summary import Metric, Metrics, saved_metrics
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
class Description:
    """Which walk: its course or a file's path, its controller or a trot's curve; startup_s: loading and compiling."""

    course: str
    controller: str
    config: Config
    seed: int
    command: tuple[str, ...]
    startup_s: float
    plots: bool = True


@dataclass(frozen=True, slots=True)
class Walked:
    """What a walk leaves for its folder.

    control: the columns of that table. ended: how, where it did not arrive. record: further fields of `RunRecord`.
    write: writes all further results.
    """

    control: Mapping[str, Any]
    metrics: Metrics
    ended: str
    lasted_s: float
    walking_s: float
    record: dict[str, Any]
    write: Callable[[Run], None] | None = None


def fill_folder(folder: Path, description: Description, walked: Walked) -> SavedMetrics:
    """Write all results of a walk, then plots and the page on them, `run.json` last. Returns the saved metrics."""
    saved, clock = saved_metrics(walked.metrics), StageClock()
    with clock.stage("report"):
        record = _record(description, walked, clock)
        run = Run.create(folder, record)
        run.write("metrics", saved)
        run.write("control", walked.control)
        _write_trajectory(run, walked.control)
        if walked.write is not None:
            walked.write(Run(folder, record))
        drawings = drawings_of(Run(folder, record))
        if description.plots:
            write_plots(folder, drawings)
    finished = _record(description, walked, clock)
    write_run_page(Run(folder, finished), drawings)
    run.finish(finished)
    return saved


def _record(description: Description, walked: Walked, clock: StageClock) -> RunRecord:
    options = {"course": description.course, "controller": description.controller, "seed": description.seed}
    warnings = [*walked.record["warnings"], *([f"the robot {walked.ended}"] if walked.ended else [])]
    spent_s = {"control": walked.walking_s, "report": clock.seconds.get("report", 0.0)}
    peaks_mb = {"control": peak_memory_mb(), "report": clock.peak_memory_mb.get("report", 0.0)}
    return RunRecord(
        quadlog_version=__version__,
        command=list(description.command),
        config=description.config,
        options=options,
        seed=description.seed,
        recorded_s=walked.lasted_s,
        stages=[StageRecord(name=name, seconds=spent_s[name], peak_memory_mb=peaks_mb[name]) for name in spent_s],
        startup_s=description.startup_s,
        realtime_factor=walked.lasted_s / walked.walking_s,
        **walked.record | {"warnings": warnings},
    )


def _write_trajectory(run: Run, control: Mapping[str, Any]) -> None:
    tilt_rad = np.column_stack([control["roll_rad"], control["pitch_rad"]])
    t_ns, x_m, y_m, yaw_rad, z_m = (control[name] for name in ("t_ns", "x_m", "y_m", "yaw_rad", "z_m"))
    write_tum(run.path / "trajectory.tum", t_ns, x_m, y_m, yaw_rad, z_m, tilt_rad)


def trotted_results(trotted: TrottedCurve) -> Walked:
    """What a trot leaves."""
    walk, robot = trotted.walk, trotted.planned.robot
    targets = trotted.planned.targets_rad.tobytes()  # the joint angles that the robot is sent to
    fallen = walk.fallen.any()
    return Walked(
        control=dict.fromkeys(TABLES["control"].names, np.full(len(walk.t_ns), np.nan)) | walk.columns(),
        metrics=trot_metrics(trotted),
        ended=f"fell after {walk.t_ns[np.argmax(walk.fallen)] / NS:.2f} s" if fallen else "",
        lasted_s=float(walk.t_ns[-1]) / NS,
        walking_s=trotted.seconds,
        record={
            "input": InputRecord(path=TROT, size_bytes=len(targets), sha256=hashlib.sha256(targets).hexdigest()),
            "counts": {"samples": len(walk.t_ns)},
            "warnings": [],
            "notes": [
                f"y(t) has a peak of {1e3 * trotted.planned.peak_m:.2f} mm",
                f"drawn: friction {robot.friction:.4f}, feet of {1e3 * robot.foot_radius_m:.2f} mm radius, a posture",
            ],
        },
    )


def walked_results(
    course: Course, path: str, ground: HeightField, remarks: Remarks, simulated: SimulatedWalk, most_n: float
) -> Walked:
    """What a walk along a course leaves. path: the course's name or file; most_n: the largest force of a foot."""

    def write(run: Run) -> None:
        _write_tables(run, course.path_m, ground)
        write_derived(run)
        write_layout(run)

    return Walked(
        control=simulated.walk.control,
        metrics=walk_metrics(simulated),
        ended=walk_verdict(simulated),
        lasted_s=_lasted_s(simulated),
        walking_s=simulated.seconds,
        record={
            "input": _walk_input(path, course.path_m),
            "counts": {"ticks": len(simulated.walk.control["t_ns"])} | simulated.counts,
            "warnings": [*remarks.warnings, *_warnings(simulated, most_n)],
            "notes": list(remarks.notes),
        },
        write=write,
    )


def walk_metrics(simulated: SimulatedWalk) -> Metrics:
    """How well the course was followed, what it cost, and how fast it was simulated."""
    walk = simulated.walk
    control = walk.control
    errors = {name: control[name] for name in ("error_m", "cross_track_m", "time_error_m", "heading_error_rad")}
    fallen = control["fallen"].astype(np.bool_) if simulated.model is not None else None
    metrics = tracking_metrics(TrackedWalk(control["t_ns"], **errors, fallen=fallen), walk.completed_ns)
    if walk.effort is not None:
        ticks = round(_lasted_s(simulated) / TIMESTEP_S)
        metrics |= effort_metrics(walk.mass_kg, ticks, walk.effort)
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


def _write_tables(run: Run, path_m: Float, ground: HeightField) -> None:
    # The course is the one plan of the walk.
    course = {"t_ns": np.zeros(len(path_m), np.int64), "i": np.arange(len(path_m))}
    x_m, y_m = path_m.T
    run.write("paths", course | {"x_m": x_m, "y_m": y_m, "smooth_x_m": x_m, "smooth_y_m": y_m})
    if not ground.is_plane:
        # A corner's height stands for the cell about it.
        origin_m = np.array(ground.origin_m) - ground.cell_m / 2
        # It is known everywhere, so that it can be a terrain again.
        seen = np.full(ground.height_m.shape, LEAST_POINTS, np.int64)
        run.write("ground", {"origin_m": origin_m, "cell_m": ground.cell_m, "height_m": ground.height_m, "count": seen})


def _walk_input(name: str, path_m: Float) -> InputRecord:
    """The file the path came from; of a course of quadlog's own, its points."""
    if name not in COURSES:
        return describe_input(Path(name))
    points = np.ascontiguousarray(path_m, np.float64).tobytes()
    return InputRecord(path=name, size_bytes=len(points), sha256=hashlib.sha256(points).hexdigest())


def _warnings(simulated: SimulatedWalk, most_n: float) -> list[str]:
    warnings = []
    if simulated.failed_solves:
        warnings.append(f"{simulated.failed_solves} solves failed, and older or simpler forces had to do: see counts")
    weight_n = simulated.walk.mass_kg * GRAVITY_MPS2
    # Two feet carry in a trot, and have to push harder than the weight to go up.
    if weight_n > 1.5 * most_n:
        warnings.append(f"the robot weighs {weight_n:.0f} N; two feet of mpc.f_max_n = {most_n:g} N may not carry it")
    return warnings
