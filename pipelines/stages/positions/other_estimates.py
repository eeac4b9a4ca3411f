"""The robot's track beside other sources of its position: a reference, or another estimate, which is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import PoseSeries
from quadlog.metrics.alignment import find_frame_offset
from quadlog.pipelines.journal import Journal
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.recordings.roles import names_estimator, names_truth

if TYPE_CHECKING:
    from quadlog.pipelines.log import LogData

SAME_M = 1e-3
"""A track whose distance from another one is less in most of its poses is that very track."""
LONGEST_GAP_S = 1.0


def settled_reference(data: LogData, journal: Journal, robot: RobotTrack) -> PoseSeries | None:
    """The reference unless the robot's track was made of it; says how far other estimates are from the track."""
    if (reference := data.streams.reference) is not None:
        journal.use("reference")
        (topic,) = data.log.roles.topics("reference")
        if not names_truth(topic) and _is_source(robot, topic, reference):
            journal.warn(
                f"no error is given: {topic}, the chosen reference, is what the robot's {robot.source} is made of"
            )
            reference = None
    for topic, poses in data.streams.estimates.items():
        if robot.source == "fixed" or ("pose" in journal.topics and topic in data.log.roles.topics("pose")):
            continue
        if _is_source(robot, topic, poses):
            journal.note(f"{topic} is not compared: the robot's {robot.source} is made of it")
        elif (apart := find_frame_offset(poses.position_m[:, :2], _track_at(robot, poses))) is not None:
            aligned = poses.frame_id != robot.frame_id
            apart_m = apart.after_m if aligned else apart.before_m
            how = " once aligned" if aligned else ""
            journal.note(f"differs from {topic} by {apart_m:.2f} m rms{how} (another estimate, not a reference)")
    return reference


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
