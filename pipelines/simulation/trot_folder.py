"""The run folder of one walk of trot-32s: table, metrics, plots and the page; `run.json` last."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from quadlog.config import Config
from quadlog.pipelines.progress import StageClock, peak_memory_mb
from quadlog.pipelines.simulation.trot import TrottedCurve, trot_metrics
from quadlog.results.frame_strip import write_frame_strip
from quadlog.results.record import InputRecord, RunRecord, StageRecord
from quadlog.results.report import write_page, write_plots
from quadlog.results.run_folder import RunFolder
from quadlog.results.schemas import TABLES
from quadlog.results.tables import write_table
from quadlog.results.tum import write_tum
from quadlog.simulation.courses import TROT
from quadlog.simulation.frames import CannotDraw, render_frames
from quadlog.version import __version__

NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TrotDescription:
    """What was simulated; startup_s: what loading and compiling took before."""

    curve: str
    config: Config
    seed: int
    command: tuple[str, ...]
    startup_s: float


def fill_trot_folder(
    folder: RunFolder, description: TrotDescription, trotted: TrottedCurve, say: Callable[[str], None]
) -> dict[str, dict[str, Any]]:
    """Write everything about a walk, and return its metrics as saved; say: told what could not be drawn."""
    run, walk, clock = folder.path, trotted.walk, StageClock()
    with clock.stage("report"):
        folder.write_config(description.config.model_dump(exclude_none=True))
        control = dict.fromkeys(TABLES["control"].names, np.full(len(walk.t_ns), np.nan)) | walk.columns()
        write_table(run / "control.parquet", TABLES["control"], control)
        write_tum(run / "trajectory.tum", walk.t_ns, control["x_m"], control["y_m"], control["yaw_rad"])
        metrics = {name: asdict(metric) for name, metric in trot_metrics(trotted).items()}
        folder.write_metrics(metrics)
        _write_frames(folder, trotted, description.config.results.frames, say)
        pictures = write_plots(run, _record(description, trotted, clock))
    record = _record(description, trotted, clock)
    write_page(run, pictures, record)
    folder.write_run_json(record)
    return metrics


def verdict(trotted: TrottedCurve) -> str:
    """That and when the robot fell; empty if it did not."""
    fallen = trotted.walk.fallen
    return f"fell after {trotted.walk.t_ns[np.argmax(fallen)] / NS:.2f} s" if fallen.any() else ""


def _write_frames(folder: RunFolder, trotted: TrottedCurve, wanted: int, say: Callable[[str], None]) -> None:
    if wanted == 0:
        return
    walk = trotted.walk
    samples = np.unique(np.linspace(0, len(walk.qpos) - 1, wanted).round().astype(np.int64))
    try:
        frames = render_frames(trotted.model.model, walk.qpos[samples])
    except CannotDraw as error:
        say(f"no pictures of the robot (plots/frames.png): MuJoCo cannot draw without a screen here: {error}")
        return
    write_frame_strip(folder.path, frames, walk.t_ns[samples] / NS)


def _record(description: TrotDescription, trotted: TrottedCurve, clock: StageClock) -> RunRecord:
    config, walk, robot = description.config, trotted.walk, trotted.planned.robot
    lasted_s = float(walk.t_ns[-1]) / NS
    return RunRecord(
        quadlog_version=__version__,
        command=list(description.command),
        config=config.model_dump(exclude_none=True),
        options={"course": TROT, "controller": description.curve, "seed": description.seed},
        input=_input(trotted),
        seed=description.seed,
        recorded_s=lasted_s,
        counts={"samples": len(walk.t_ns)},
        warnings=[f"the robot {ended}"] if (ended := verdict(trotted)) else [],
        notes=[
            f"y(t) has a peak of {1e3 * trotted.planned.peak_m:.2f} mm",
            f"drawn: friction {robot.friction:.4f}, feet of {1e3 * robot.foot_radius_m:.2f} mm radius, and a posture",
        ],
        stages=[
            StageRecord("control", trotted.seconds, peak_memory_mb()),
            StageRecord("report", clock.seconds.get("report", 0.0), clock.peak_memory_mb.get("report", 0.0)),
        ],
        startup_s=description.startup_s,
        realtime_factor=lasted_s / trotted.seconds,
    )


def _input(trotted: TrottedCurve) -> InputRecord:
    """The joint angles that the robot is sent to."""
    targets = trotted.planned.targets_rad.tobytes()
    return InputRecord(TROT, len(targets), hashlib.sha256(targets).hexdigest())
