"""Stage `report`: metrics, exports, plots and the page, all from what is saved; `run.json` last."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.geometry import quat_from_yaw, yaw_from_quat
from quadlog.messages import PoseSeries
from quadlog.metrics.metric import Metric, Metrics
from quadlog.metrics.planning import Replans, search_metrics
from quadlog.metrics.positioning import Trajectory, trajectory_metrics, uwb_metrics
from quadlog.metrics.walking import TrackedWalk, effort_metrics, tracking_metrics
from quadlog.pipelines.stages.context import ReplayContext, WalkedBody
from quadlog.pipelines.stages.tag_errors import lever_of, roles_of, tag_truth
from quadlog.planning.registry import planner_plugin, planner_type
from quadlog.recordings.decoding import decoder_plugin
from quadlog.results.foxglove.derived_mcap import write_derived
from quadlog.results.foxglove.layout import write_layout
from quadlog.results.page.report import write_page, write_plots
from quadlog.results.run.record import LossRecord, PluginRecord, RunRecord, StageRecord, TopicRecord
from quadlog.results.run.stages import STAGES, stages_until
from quadlog.results.run.tables import has_table, read_table
from quadlog.storage.formats.tum import read_tum
from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.pipelines.request import ReplayRequest


def positioning_metrics(run: Path, config: Config, robot_tag: int | None, same_frame: bool) -> Metrics:
    """UWB residuals; with reference.tum also the fixes' and the poses' error against it.

    The reference is a pose of base; a fix is compared with where the tag, at
    its place in base, must have been. Poses that are not in the reference's
    frame have no ate_rmse_m: where they start would be most of it.
    """
    reference = _read_reference(run)
    metrics: Metrics = {}
    if robot_tag is not None and has_table(run, "fixes"):
        fixes = read_table(run, "fixes")
        own = fixes["tag"] == robot_tag
        error_m = None
        if reference is not None:
            truth_m = tag_truth(fixes["t_ns"][own], reference, lever_of(config, robot_tag))
            error_m = np.column_stack([fixes["x_m"][own], fixes["y_m"][own]]) - truth_m
        metrics |= uwb_metrics(error_m, fixes["residual_rms_m"][own], fixes["n_ranges"][own])
    if reference is not None and has_table(run, "poses"):
        poses = read_table(run, "poses")
        if len(poses["t_ns"]) and poses["source"][0] != "fixed":
            position_m = np.column_stack([poses["x_m"], poses["y_m"], np.zeros(len(poses["t_ns"]))])
            estimate = Trajectory(poses["t_ns"], position_m, quat_from_yaw(poses["yaw_rad"]))
            metrics |= trajectory_metrics(_trajectory(reference), estimate)
            if not same_frame:
                metrics.pop("ate_rmse_m", None)
    return metrics


def planning_metrics(run: Path) -> Metrics:
    """Cells, success and excess cost of the logged walk's replans."""
    if not has_table(run, "plans"):
        return {}
    plans = read_table(run, "plans")
    if len(plans["t_ns"]) == 0:
        return {}
    names = ("t_ns", "found", "expanded", "generated", "cost", "optimal_cost", "from_scratch")
    astar_expanded = read_table(run, "astar", ["expanded"])["expanded"]
    replans = Replans(**{name: plans[name] for name in names}, astar_expanded=astar_expanded)
    return search_metrics(replans, incremental=planner_type(str(plans["planner"][0])).incremental)


def control_metrics(run: Path, body: WalkedBody | None) -> Metrics:
    """Tracking error, clearance, distance kept and, of a robot with a body, its effort, of the re-simulated walk."""
    if not has_table(run, "control"):
        return {}
    control, near = read_table(run, "control"), read_table(run, "clearances")
    walk = TrackedWalk(
        t_ns=control["t_ns"],
        error_m=control["error_m"],
        cross_track_m=control["cross_track_m"],
        time_error_m=control["time_error_m"],
        heading_error_rad=control["heading_error_rad"],
        plan_error_m=control["plan_error_m"],
        clearance_m=near["clearance_m"],
        target_distance_m=near["target_distance_m"],
        fallen=None if body is None else control["fallen"],
    )
    return tracking_metrics(walk) | ({} if body is None else _effort(body))


def _effort(body: WalkedBody) -> Metrics:
    return effort_metrics(body.mass_kg, body.ticks, **asdict(body.effort))


def _read_reference(run: Path) -> PoseSeries | None:
    path = run / "reference.tum"
    return read_tum(path) if path.is_file() else None


def _trajectory(poses: PoseSeries) -> Trajectory:
    """A reference in the plane, as the robot's poses are."""
    position_m = poses.position_m * np.array([1.0, 1.0, 0.0])
    return Trajectory(poses.t_ns, position_m, quat_from_yaw(yaw_from_quat(poses.quat_xyzw)))


CHOSEN = "chosen in the configuration"


def finish_walk(walk: ReplayContext, request: ReplayRequest, startup_s: float) -> dict[str, dict[str, Any]]:
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


def _realtime_factor(walk: ReplayContext, request: ReplayRequest) -> float | None:
    """Recorded seconds over seconds in the stages asked for; None when there is nothing to divide."""
    seconds = sum(walk.clock.seconds.get(name, 0.0) for name in stages_until(request.options.until))
    return walk.recorded_s / seconds if walk.recorded_s > 0 and seconds > 0 else None


def _metrics(walk: ReplayContext) -> Metrics:
    metrics = positioning_metrics(walk.run.path, walk.config, _robot_tag(walk), _in_reference_frame(walk))
    metrics |= planning_metrics(walk.run.path)
    metrics |= control_metrics(walk.run.path, walk.body)
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


def _robot_tag(walk: ReplayContext) -> int | None:
    if walk.streams.ranges is None:
        return None
    return roles_of(walk.config, sorted({int(tag) for tag in walk.streams.ranges.tag})).get("robot")


def _record(walk: ReplayContext, request: ReplayRequest, startup_s: float) -> RunRecord:
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


def _plugins(walk: ReplayContext, request: ReplayRequest) -> list[PluginRecord]:
    """The plug-ins among the decoders of the topics used and, where there was planning, the planner."""
    used = {topic for topics in walk.used.values() for topic in topics}
    types = sorted({each.type_name for each in walk.recording.channels if each.topic in used})
    found = [decoder_plugin(name) for name in types]
    if "plan" in stages_until(request.options.until):
        found.append(planner_plugin(walk.config.planner.name))
    return [PluginRecord(each.group, each.name, each.distribution, each.version) for each in found if each is not None]


def _topics(walk: ReplayContext) -> list[TopicRecord]:
    """Every topic that was used, in what role, and why it was chosen for it."""
    channels = {channel.topic: channel for channel in walk.recording.channels}
    whys = {name: role.why for name, role in walk.roles.found.items()}
    return [
        TopicRecord(role, topic, channels[topic].type_name, channels[topic].count or 0, whys.get(role, CHOSEN))
        for role, topics in walk.used.items()
        for topic in topics
    ]
