"""The robot's track beside what else tells where it was: a reference, or another estimate, which is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.messages import PoseSeries
from quadlog.metrics.alignment import find_frame_offset
from quadlog.pipelines.stages.context import ReplayContext, RobotTrack
from quadlog.recordings.roles import names_estimator, names_truth

SAME_M = 1e-3
"""A track whose distance from another one is less in most of its poses is that very track."""
LONGEST_GAP_S = 1.0


def settle_reference(walk: ReplayContext, robot: RobotTrack) -> None:
    """Drop a reference that the robot's track was made of, and say how far other estimates are from the track."""
    if (reference := walk.streams.reference) is not None:
        walk.use("reference")
        (topic,) = walk.used["reference"]
        if not names_truth(topic) and _is_source(robot, topic, reference):
            walk.warn(
                f"no error is given: {topic}, the chosen reference, is what the robot's {robot.source} is made of"
            )
            walk.streams = replace(walk.streams, reference=None)
    for topic, poses in walk.streams.estimates.items():
        if topic in walk.used.get("pose", ()) or robot.source == "fixed":
            continue
        if _is_source(robot, topic, poses):
            walk.note(f"{topic} is not compared: the robot's {robot.source} is made of it")
        elif (apart := find_frame_offset(poses.position_m[:, :2], _track_at(robot, poses))) is not None:
            aligned = poses.frame_id != robot.frame_id
            apart_m = apart.after_m if aligned else apart.before_m
            how = " once aligned" if aligned else ""
            walk.note(f"differs from {topic} by {apart_m:.2f} m rms{how} (another estimate, not a reference)")


def _is_source(robot: RobotTrack, topic: str, poses: PoseSeries) -> bool:
    """Whether poses in the track's own frame are by an estimator that tf gets this frame from, or the track itself."""
    if poses.frame_id != robot.frame_id:
        return False
    if robot.source == "tf" and names_estimator(topic):
        return True
    apart_m = np.hypot(*(_track_at(robot, poses) - poses.position_m[:, :2]).T)
    known = np.isfinite(apart_m)
    return bool(known.any() and np.median(apart_m[known]) < SAME_M)


def _track_at(robot: RobotTrack, poses: PoseSeries) -> np.ndarray:
    return robot.poses_at(poses.t_ns, LONGEST_GAP_S)[:, :2]
