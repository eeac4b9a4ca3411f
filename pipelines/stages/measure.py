"""Every metric of a replay, from the tables it has saved and what its robot's joints took."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from quadlog.config import Config
from quadlog.geometry import quat_from_yaw, yaw_from_quat
from quadlog.messages import PoseSeries
from quadlog.metrics.effort import effort_metrics
from quadlog.metrics.metric import Metrics
from quadlog.metrics.positioning import Trajectory, trajectory_metrics, uwb_metrics
from quadlog.metrics.search import Replans, search_metrics
from quadlog.metrics.tracking import TrackedWalk, tracking_metrics
from quadlog.pipelines.stages.walk import WalkedBody
from quadlog.pipelines.tag_roles import lever_of
from quadlog.pipelines.tag_truth import tag_truth
from quadlog.planning.registry import planner_type
from quadlog.results.tables import has_table, read_table
from quadlog.results.tum import read_tum


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
    replans = Replans(
        found=plans["found"],
        expanded=plans["expanded"],
        generated=plans["generated"],
        cost=plans["cost"],
        optimal_cost=plans["optimal_cost"],
        from_scratch=plans["from_scratch"],
        astar_expanded=read_table(run, "astar", ["expanded"])["expanded"],
    )
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
