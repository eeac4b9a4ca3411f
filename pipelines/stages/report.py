"""Stage `report`: metrics, exports, plots and the page, all from what is saved; `run.json` last."""

from __future__ import annotations

import gc
import math
from pathlib import Path
from typing import Any

from quadlog.config.controllers import controller_plugin
from quadlog.config.schema import Config
from quadlog.metrics.planning import ratio_to_astar
from quadlog.metrics.reference_offset import FRAME_METRICS, TRAJECTORY_METRICS
from quadlog.metrics.summary import Metric, Metrics, metrics_of, saved_metrics
from quadlog.metrics.walking import effort_metrics
from quadlog.pipelines.evaluation.body import known_robot, write_bodies
from quadlog.pipelines.evaluation.reference import RobotTag, compare_with_own_reference
from quadlog.pipelines.evaluation.samples import SAMPLED, read_samples
from quadlog.pipelines.replay import StageResults
from quadlog.pipelines.request import ReplayRequest
from quadlog.pipelines.stages.log import Log
from quadlog.pipelines.stages.positions.uwb import with_anchors
from quadlog.pipelines.store import Doing, run_key
from quadlog.recordings.decoding import decoder_plugin
from quadlog.results import STAGES, stages_until
from quadlog.results.figures import drawings_of, write_plots
from quadlog.results.foxglove import write_foxglove
from quadlog.results.page.run_page import write_run_page
from quadlog.results.record import PluginRecord, RunRecord, StageRecord, TopicRecord, location_of
from quadlog.results.run import Run, create_run, finish_run, write_result
from quadlog.results.tables import has_table, read_table
from quadlog.version import __version__

CHOSEN = "chosen in the configuration"


class Finished:
    """All that is known at the end of a replay. startup_s: as StartUp has it.

    tracks, body: None where no stage gave them. results: keys of what the stages left.
    """

    def __init__(self, request: ReplayRequest, log: Log, do: Doing, made: StageResults, startup_s: float) -> None:
        """With the results of the stages that were done."""
        self.request, self.log, self.startup_s, self.facts = request, log, startup_s, made.facts.get()
        self.tracks = made.tracks.get() if "position" in do.keys else None
        self.body = made.body.get() if "control" in do.keys else None
        self.journal, self.reused, self.results = do.journal, do.reused, do.keys | {"run": run_key(request)}

    @property
    def config(self) -> Config:
        """The effective configuration: with the anchors that the messages place, where none are configured."""
        return with_anchors(self.request.config, self.facts.anchors) if self.facts.anchors else self.request.config

    @property
    def recorded_s(self) -> float:
        """Length of what was replayed."""
        return (self.facts.last_ns - self.facts.first_ns) * 1e-9

    @property
    def realtime_factor(self) -> float | None:
        """Recorded seconds without pauses over seconds in the stages asked for; None if either is zero."""
        seconds = sum(self.journal.clock.seconds.get(name, 0.0) for name in stages_until(self.request.options.until))
        logged_s = self.recorded_s - self.journal.counts.get("paused_ms", 0) * 1e-3
        return logged_s / seconds if logged_s > 0 and seconds > 0 else None


def finish(folder: Path, done: Finished) -> dict[str, dict[str, Any]]:
    """Write what the stages that ran allow, `run.json` last. Returns the metrics as saved."""
    journal, request = done.journal, done.request
    journal.progress.begin("report", 4)
    gc.freeze()  # a replay holds much that drawing need not search for garbage again and again
    with journal.clock.stage("report"):
        run = create_run(folder, _record(done))
        metrics = _metrics(folder, done)
        write_result(run, "metrics", saved_metrics(metrics))
        journal.progress.advance()
        results = Run(folder, _record(done))
        if request.draws and done.tracks is not None:
            write_foxglove(results)
        journal.progress.advance()
        drawings = drawings_of(results) if request.draws else {}
        if request.plots:
            write_plots(folder, drawings)
        journal.progress.advance()
    # How fast it went stands on the page itself, so the page, and nothing else, is written off the clock.
    if (factor := done.realtime_factor) is not None:
        metrics["realtime_factor"] = Metric(factor, 1, "")
    write_result(run, "metrics", saved_metrics(metrics))
    if request.draws:
        write_run_page(Run(folder, _record(done)), drawings)
    journal.progress.advance()
    gc.unfreeze()
    finish_run(run, _record(done))
    return saved_metrics(metrics)


def _metrics(run: Path, done: Finished) -> Metrics:
    """What the saved tables give, and what the robot's body took, which they do not hold."""
    plans = read_table(run, "plans", ["t_ns", "planner", "expanded"]) if has_table(run, "plans") else None
    robot = RobotTag.among(list(done.facts.tags), done.config)
    incremental = False
    if plans is not None and len(plans["planner"]):
        from quadlog.planning.registry import planner_type

        incremental = planner_type(str(plans["planner"][0])).incremental
    # Of other planners, fallback_share would be a wrong number.
    wanted = SAMPLED - {*TRAJECTORY_METRICS, *([] if plans is None or incremental else ["fallback_share"])}
    samples, errors = read_samples(run, wanted, robot)
    if errors:
        raise errors[0]
    body = done.body
    walk = {} if body is None else read_table(run, "control", ["t_ns", "x_m", "y_m"])
    effort = {} if body is None else effort_metrics(body.mass_kg, body.ticks, body.effort, walk)
    metrics = metrics_of(samples) | _trajectory_metrics(run, done) | _of_bodies(run, done, effort)
    if plans is not None:
        astar = read_table(run, "astar", ["expanded"])["expanded"]
        metrics |= ratio_to_astar(plans["t_ns"], plans["expanded"], astar)
    return metrics | effort


def _of_bodies(run: Path, done: Finished, effort: Metrics) -> Metrics:
    """body.parquet, gait.parquet and the metrics of bodies that no samples give; nothing without a logged body."""
    if not (has_table(run, "joints") and has_table(run, "poses")):
        return {}
    known, body = known_robot(done.config), done.body
    if known is None:
        done.journal.note("no logged_cost_of_transport: set robot.model")
    masses_kg = {
        "logged": math.nan if known is None else known.mass_kg,
        "resimulated": math.nan if body is None else body.mass_kg,
    }
    return write_bodies(run, masses_kg, effort["cost_of_transport"].value if effort else math.nan)


def _trajectory_metrics(run: Path, done: Finished) -> Metrics:
    """Errors of the poses against the reference; a clock or a frame that differs from the reference's is warned of.

    Poses in another frame than the reference by its name have no ate_rmse_m: where they start would be most of it.
    """
    if done.tracks is None or done.tracks.robot.source == "fixed":
        return {}
    if (compared := compare_with_own_reference(run)) is None:
        return {}
    metrics, journal = metrics_of(compared.samples), done.journal
    frame, reference = done.tracks.robot.frame_id, done.tracks.reference_frame
    # UWB's frame has no name in the recording: the anchors are given in the reference's frame.
    elsewhere = bool(frame and reference and frame != reference)
    if elsewhere:
        journal.warn(f"no ate_rmse_m: poses are in the frame {frame!r}, the reference is in {reference!r}")
    if compared.warnings or elsewhere:
        journal.note(f"errors against the reference are in {compared.dimensions}")
    else:
        journal.note(f"against the reference: {compared.summary}")
    journal.warn(*(compared.in_any_frame if elsewhere else compared.warnings))
    return {name: each for name, each in metrics.items() if not elsewhere or name not in FRAME_METRICS}


def _record(done: Finished) -> RunRecord:
    journal, request = done.journal, done.request
    clock = journal.clock
    return RunRecord(
        quadlog_version=__version__,
        command=list(request.command),
        config=done.config,
        options=request.options.to_dict(),
        input=done.facts.input.model_copy(update={"path": location_of(request.recording)}),
        seed=request.options.seed,
        recorded_s=done.recorded_s,
        topics=_topics(done),
        counts=dict(journal.counts),
        losses=list(journal.losses),
        warnings=journal.warnings,
        notes=[*request.notes, *journal.notes],
        stages=[
            StageRecord(name=name, seconds=clock.seconds[name], peak_memory_mb=clock.peak_memory_mb[name])
            for name in STAGES
            if name in clock.seconds
        ],
        startup_s=done.startup_s,
        realtime_factor=done.realtime_factor,
        reused=done.reused,
        plugins=_plugins(done),
        anchors_from_messages=bool(done.facts.anchors),
        results=done.results,
    )


def _plugins(done: Finished) -> list[PluginRecord]:
    """The plug-ins among the decoders of the topics used, the planner and the controller, as far as it went."""
    used = {each.topic for each in _topics(done)}
    types = sorted({each.type_name for each in done.log.recording.channels if each.topic in used})
    found = [decoder_plugin(name) for name in types]
    if "plan" in stages_until(done.request.options.until):
        from quadlog.planning.registry import planner_plugin  # with compiled code, which has been loaded then

        found.append(planner_plugin(done.config.planner.name))
    if done.body is not None:
        found.append(controller_plugin(done.config.simulation.controller))
    return PluginRecord.of(found)


def _topics(done: Finished) -> list[TopicRecord]:
    """Every topic that was used, in what role, and why it was chosen for it."""
    roles = done.log.roles
    channels = {channel.topic: channel for channel in done.log.recording.channels}
    whys = {name: role.why for name, role in roles.found.items()}
    return [
        TopicRecord(
            role=role,
            topic=topic,
            type=channels[topic].type_name,
            messages=channels[topic].count,
            why=whys.get(role, CHOSEN),
        )
        for role, topics in done.journal.topics.items()
        for topic in topics or roles.topics(role)
    ]
