"""Stage `report`: metrics, exports, plots and the page, all from what is saved; `run.json` last."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.metrics.metric import Metric, Metrics, saved_metrics
from quadlog.metrics.planning import ratio_to_astar
from quadlog.metrics.reference_offset import FRAME_METRICS, TRAJECTORY_METRICS
from quadlog.metrics.summary import metrics_of
from quadlog.metrics.walking import effort_metrics
from quadlog.pipelines.evaluation.body import compare_bodies, known_body, write_bodies
from quadlog.pipelines.evaluation.reference import RobotTag, compare_with_own_reference
from quadlog.pipelines.evaluation.samples import SAMPLED, read_samples
from quadlog.pipelines.simulation.courses import walkable_ground
from quadlog.pipelines.stages.context import ReplayContext
from quadlog.planning.registry import planner_plugin, planner_type
from quadlog.recordings.decoding import decoder_plugin
from quadlog.results.figures import drawings_of, write_plots
from quadlog.results.foxglove import write_derived, write_layout
from quadlog.results.page.run_page import write_run_page
from quadlog.results.record import LossRecord, PluginRecord, RunRecord, StageRecord, TopicRecord
from quadlog.results.run import Run
from quadlog.results.stages import STAGES, stages_until
from quadlog.results.tables import has_table, read_table
from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.pipelines.request import ReplayRequest


CHOSEN = "chosen in the configuration"


def finish_walk(walk: ReplayContext, request: ReplayRequest, startup_s: float) -> dict[str, dict[str, Any]]:
    """Write what the stages that ran allow, and mark the run as finished. Returns the metrics as saved."""
    run = walk.run.path
    walk.progress.begin("report", 4)
    with walk.clock.stage("report"):
        walk.begin_folder()
        metrics = _metrics(walk)
        walk.run.write("metrics", saved_metrics(metrics))
        walk.progress.advance()
        results = Run(run, _record(walk, request, startup_s))
        if walk.robot is not None:
            write_derived(results)
            write_layout(results)
        walk.progress.advance()
        drawings = drawings_of(results) if request.draws else {}
        if request.plots:
            write_plots(run, drawings)
        walk.progress.advance()
    # How fast it went stands on the page itself, so the page, and nothing else, is written off the clock.
    if (factor := _realtime_factor(walk, request)) is not None:
        metrics["realtime_factor"] = Metric(factor, 1, "")
    walk.run.write("metrics", saved_metrics(metrics))
    record = _record(walk, request, startup_s)
    if request.draws:
        write_run_page(Run(run, record), drawings)
    walk.progress.advance()
    walk.check_left()
    walk.run.finish(record)
    walk.say_what_is_new()
    return saved_metrics(metrics)


def _realtime_factor(walk: ReplayContext, request: ReplayRequest) -> float | None:
    """Recorded seconds over seconds in the stages asked for; None when there is nothing to divide."""
    seconds = sum(walk.clock.seconds.get(name, 0.0) for name in stages_until(request.options.until))
    return walk.recorded_s / seconds if walk.recorded_s > 0 and seconds > 0 else None


def _metrics(walk: ReplayContext) -> Metrics:
    """What the saved tables give, and what the robot's body took, which they do not hold."""
    run, body = walk.run.path, walk.body
    plans = read_table(run, "plans", ["planner", "expanded"]) if has_table(run, "plans") else None
    ranges = walk.streams.ranges
    robot = RobotTag.among([] if ranges is None else np.unique(ranges.tag).tolist(), walk.config)
    wanted = SAMPLED - {*TRAJECTORY_METRICS, *_not_applicable(plans)}
    samples, errors = read_samples(run, wanted, may_lack=True, robot=robot)
    if errors:
        raise errors[0]
    metrics = metrics_of(samples) | _trajectory_metrics(walk) | _of_bodies(walk)
    if plans is not None:
        metrics |= ratio_to_astar(plans["expanded"], read_table(run, "astar", ["expanded"])["expanded"])
    return metrics if body is None else metrics | effort_metrics(body.mass_kg, body.ticks, **asdict(body.effort))


def _of_bodies(walk: ReplayContext) -> Metrics:
    """body.parquet, gait.parquet and the metrics of bodies that no samples give; nothing without a logged body."""
    run, config, body = walk.run.path, walk.config, walk.body
    for name in ("body", "gait"):
        (run / f"{name}.parquet").unlink(missing_ok=True)  # of an earlier replay
    if not (has_table(run, "joints") and has_table(run, "poses")):
        return {}
    known = known_body(config)
    if known is None:
        walk.note("no logged_cost_of_transport and no height of the body: set robot.preset or robot.model")
    ground = None if body is None else walkable_ground(run, config.simulation.friction)[0]
    bodies = compare_bodies(run, None if known is None else known.geometry, ground)
    cost = {} if body is None else effort_metrics(body.mass_kg, body.ticks, **asdict(body.effort))
    resimulated_cost = cost["cost_of_transport"].value if "cost_of_transport" in cost else math.nan
    masses_kg = {
        "logged": math.nan if known is None else known.mass_kg,
        "resimulated": math.nan if body is None else body.mass_kg,
    }
    return write_bodies(run, bodies, masses_kg, resimulated_cost)


def _not_applicable(plans: Mapping[str, Any] | None) -> set[str]:
    """Metrics that the tables would give, but that would be wrong numbers."""
    incremental = plans is not None and len(plans["planner"]) and planner_type(str(plans["planner"][0])).incremental
    return set() if plans is None or incremental else {"fallback_share"}


def _trajectory_metrics(walk: ReplayContext) -> Metrics:
    """Errors of the poses against the reference; a clock or a frame that differs from the reference's is warned of.

    Poses in another frame than the reference by its name have no ate_rmse_m: where they start would be most of it.
    """
    compared = None
    if walk.robot is not None and walk.robot.source != "fixed":
        compared = compare_with_own_reference(walk.run.path)
    if compared is None:
        return {}
    metrics = metrics_of(compared.samples)
    in_its_frame = _in_reference_frame(walk)
    if compared.warnings or not in_its_frame:
        walk.note(f"errors against the reference are in {compared.dimensions}")
    if not in_its_frame and compared.mirrored is not None:
        walk.warn(compared.mirrored)
    if not in_its_frame:
        return {name: each for name, each in metrics.items() if name not in FRAME_METRICS}
    if not compared.warnings:
        walk.note(f"against the reference: {compared.summary}")
    for words in compared.warnings:
        walk.warn(words)
    return metrics


def _in_reference_frame(walk: ReplayContext) -> bool:
    """Whether poses and reference can be compared: only frames that are both named and differ cannot, which is said.

    UWB's frame has no name in the recording: the anchors are given in the reference's frame.
    """
    robot, reference = walk.robot, walk.streams.reference
    if robot is None or reference is None or not robot.frame_id or not reference.frame_id:
        return True
    same = robot.frame_id == reference.frame_id
    if not same:
        walk.warn(
            f"no ate_rmse_m: poses are in the frame {robot.frame_id!r}, the reference is in {reference.frame_id!r}"
        )
    return same


def _record(walk: ReplayContext, request: ReplayRequest, startup_s: float) -> RunRecord:
    clock = walk.clock
    ran = [name for name in STAGES if name in clock.seconds]
    return RunRecord(
        quadlog_version=__version__,
        command=list(request.command),
        config=walk.config,
        options=request.options.to_dict(),
        input=walk.input,
        seed=walk.seed,
        recorded_s=walk.recorded_s,
        topics=_topics(walk),
        counts=dict(walk.counts),
        losses=[LossRecord(**asdict(loss)) for loss in walk.losses],
        warnings=walk.warnings,
        notes=[*request.notes, *walk.notes],
        stages=[
            StageRecord(name=stage, seconds=clock.seconds[stage], peak_memory_mb=clock.peak_memory_mb[stage])
            for stage in ran
        ],
        startup_s=startup_s,
        realtime_factor=_realtime_factor(walk, request),
        reused=walk.reused,
        plugins=_plugins(walk, request),
        anchors_from_messages=walk.anchors_from_messages,
    )


def _plugins(walk: ReplayContext, request: ReplayRequest) -> list[PluginRecord]:
    """The plug-ins among the decoders of the topics used and, where there was planning, the planner."""
    used = {topic for topics in walk.used.values() for topic in topics}
    types = sorted({each.type_name for each in walk.recording.channels if each.topic in used})
    found = [decoder_plugin(name) for name in types]
    if "plan" in stages_until(request.options.until):
        found.append(planner_plugin(walk.config.planner.name))
    names = ("group", "name", "distribution", "version")
    return [PluginRecord(**{name: getattr(one, name) for name in names}) for one in found if one is not None]


def _topics(walk: ReplayContext) -> list[TopicRecord]:
    """Every topic that was used, in what role, and why it was chosen for it."""
    channels = {channel.topic: channel for channel in walk.recording.channels}
    whys = {name: role.why for name, role in walk.roles.found.items()}
    return [
        TopicRecord(
            role=role,
            topic=topic,
            type=channels[topic].type_name,
            messages=channels[topic].count or 0,
            why=whys.get(role, CHOSEN),
        )
        for role, topics in walk.used.items()
        for topic in topics
    ]
