"""Stage `report`: metrics, exports, plots and the page, all from what is saved; `run.json` last."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from quadlog.metrics.metric import Metric, Metrics
from quadlog.pipelines.metrics import control_metrics, planning_metrics, positioning_metrics
from quadlog.pipelines.stages.uwb import roles_of
from quadlog.pipelines.stages.walk import Walk
from quadlog.results.derived_mcap import write_derived
from quadlog.results.layout import write_layout
from quadlog.results.record import LossRecord, RunRecord, StageRecord, TopicRecord
from quadlog.results.report import write_report
from quadlog.stages import STAGES
from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest


def finish_walk(walk: Walk, request: ReplayRequest, startup_s: float) -> dict[str, dict[str, Any]]:
    """Write what the stages that ran allow, and mark the run as finished. Returns the metrics as saved."""
    walk.progress.begin("report", None)
    with walk.clock.stage("report"):
        metrics = _metrics(walk)
        saved = {name: asdict(metric) for name, metric in metrics.items()}
        walk.run.write_metrics(saved)
        if walk.robot is not None:
            write_derived(walk.run.path)
            write_layout(walk.run.path)
        write_report(walk.run.path, _record(walk, request, startup_s))
    walk.run.write_run_json(_record(walk, request, startup_s))
    return saved


def _metrics(walk: Walk) -> Metrics:
    metrics = positioning_metrics(walk.run.path, walk.config, _robot_tag(walk))
    metrics |= planning_metrics(walk.run.path, walk.astar_expanded)
    metrics |= control_metrics(walk.run.path, walk.clearance_m, walk.target_distance_m)
    seconds = sum(seconds for name, seconds in walk.clock.seconds.items() if name != "report")
    if walk.recorded_s > 0 and seconds > 0:
        metrics["realtime_factor"] = Metric(walk.recorded_s / seconds, 1, "")
    return metrics


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
        stages=[StageRecord(name, clock.seconds[name], clock.peak_memory_mb[name]) for name in ran],
        startup_s=startup_s,
    )


def _topics(walk: Walk) -> list[TopicRecord]:
    """Every topic that played a role in this replay, and why it did."""
    channels = {channel.topic: channel for channel in walk.recording.channels}
    return [
        TopicRecord(role.name, topic, channels[topic].type_name, channels[topic].count or 0, role.why)
        for role in walk.roles.found.values()
        for topic in role.topics
    ]
