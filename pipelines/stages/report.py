"""Stage `report`: metrics, exports, plots and the page, all from what is saved; `run.json` last."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from quadlog.metrics.metric import Metric, Metrics
from quadlog.pipelines.stages.measure import control_metrics, planning_metrics, positioning_metrics
from quadlog.pipelines.stages.walk import Walk
from quadlog.pipelines.tag_roles import roles_of
from quadlog.planning.registry import planner_plugin
from quadlog.recordings.decoding import decoder_plugin
from quadlog.results.derived_mcap import write_derived
from quadlog.results.layout import write_layout
from quadlog.results.record import LossRecord, PluginRecord, RunRecord, StageRecord, TopicRecord
from quadlog.results.report import write_page, write_plots
from quadlog.stages import STAGES, stages_until
from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest

CHOSEN = "chosen in the configuration"


def finish_walk(walk: Walk, request: ReplayRequest, startup_s: float) -> dict[str, dict[str, Any]]:
    """Write what the stages that ran allow, and mark the run as finished. Returns the metrics as saved."""
    run = walk.run.path
    walk.progress.begin("report", None)
    with walk.clock.stage("report"):
        walk.begin_folder()
        metrics = _metrics(walk)
        walk.run.write_metrics(_plain(metrics))
        if walk.robot is not None:
            write_derived(run, record=_record(walk, request, startup_s))
            write_layout(run)
        pictures = write_plots(run, _record(walk, request, startup_s))
    # How fast it went stands on the page itself, so the page, and nothing else, is written off the clock.
    if (factor := _realtime_factor(walk, request)) is not None:
        metrics["realtime_factor"] = Metric(factor, 1, "")
    walk.run.write_metrics(_plain(metrics))
    record = _record(walk, request, startup_s)
    write_page(run, pictures, record)
    walk.check_left()
    walk.run.write_run_json(record)
    walk.say_what_is_new()
    return _plain(metrics)


def _plain(metrics: Metrics) -> dict[str, dict[str, Any]]:
    return {name: asdict(metric) for name, metric in metrics.items()}


def _realtime_factor(walk: Walk, request: ReplayRequest) -> float | None:
    """Recorded seconds over seconds in the stages asked for; None when there is nothing to divide."""
    seconds = sum(walk.clock.seconds.get(name, 0.0) for name in stages_until(request.options.until))
    return walk.recorded_s / seconds if walk.recorded_s > 0 and seconds > 0 else None


def _metrics(walk: Walk) -> Metrics:
    metrics = positioning_metrics(walk.run.path, walk.config, _robot_tag(walk), _in_reference_frame(walk))
    metrics |= planning_metrics(walk.run.path)
    metrics |= control_metrics(walk.run.path, walk.body)
    return metrics


def _in_reference_frame(walk: Walk) -> bool:
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


def _robot_tag(walk: Walk) -> int | None:
    if walk.streams.ranges is None:
        return None
    return roles_of(walk.config, sorted({int(tag) for tag in walk.streams.ranges.tag})).get("robot")


def _record(walk: Walk, request: ReplayRequest, startup_s: float) -> RunRecord:
    clock = walk.clock
    ran = [name for name in STAGES if name in clock.seconds]
    return RunRecord(
        quadlog_version=__version__,
        command=list(request.command),
        config=walk.config.model_dump(exclude_none=True),
        options=request.options.to_dict(),
        input=walk.input,
        seed=walk.seed,
        recorded_s=walk.recorded_s,
        topics=_topics(walk),
        counts=dict(walk.counts),
        losses=[LossRecord(each.cause, each.detail, each.topic, each.count) for each in walk.losses],
        warnings=walk.warnings,
        notes=[*request.notes, *walk.notes],
        stages=[StageRecord(name, clock.seconds[name], clock.peak_memory_mb[name]) for name in ran],
        startup_s=startup_s,
        realtime_factor=_realtime_factor(walk, request),
        reused=walk.reused,
        plugins=_plugins(walk, request),
    )


def _plugins(walk: Walk, request: ReplayRequest) -> list[PluginRecord]:
    """The plug-ins among the decoders of the topics used and, where there was planning, the planner."""
    used = {topic for topics in walk.used.values() for topic in topics}
    types = sorted({each.type_name for each in walk.recording.channels if each.topic in used})
    found = [decoder_plugin(name) for name in types]
    if "plan" in stages_until(request.options.until):
        found.append(planner_plugin(walk.config.planner.name))
    return [PluginRecord(each.group, each.name, each.distribution, each.version) for each in found if each is not None]


def _topics(walk: Walk) -> list[TopicRecord]:
    """Every topic that was used, in what role, and why it was chosen for it."""
    channels = {channel.topic: channel for channel in walk.recording.channels}
    whys = {name: role.why for name, role in walk.roles.found.items()}
    return [
        TopicRecord(role, topic, channels[topic].type_name, channels[topic].count or 0, whys.get(role, CHOSEN))
        for role, topics in walk.used.items()
        for topic in topics
    ]
