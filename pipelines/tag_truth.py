"""Where the tags on the robot were by a reference: its poses are of base, fixes and tracks are of tags."""

from __future__ import annotations

import numpy as np

from quadlog.config import Config
from quadlog.geometry import yaw_from_quat
from quadlog.messages import Float, Int, PoseSeries
from quadlog.metrics.positioning import Trajectory, positions_at
from quadlog.positioning.lever_arm import base_to_tag

REFERENCE_GAP_NS = 100_000_000


def levers_on_robot(config: Config, robot_tag: int | None) -> dict[int, tuple[float, float]]:
    """Tag -> where it sits in base, x_m and y_m: the robot's, and further tags whose table gives them such a place."""
    levers = {} if robot_tag is None else {robot_tag: (0.0, 0.0)}
    for tag in config.uwb.tags:
        if tag.id == robot_tag or (tag.role == "none" and (tag.x_m, tag.y_m) != (0.0, 0.0)):
            levers[tag.id] = (tag.x_m, tag.y_m)
    return levers


def tag_truth(t_ns: Int, reference: PoseSeries, lever_m: tuple[float, float]) -> Float:
    """(N, 2) where a tag with that place in base was in map at t_ns (N,), NaN where the reference is silent."""
    yaw_rad = yaw_from_quat(reference.quat_xyzw)
    tag_m = base_to_tag(reference.position_m[:, :2], yaw_rad, *lever_m)
    at_tag = Trajectory(reference.t_ns, np.column_stack([tag_m, np.zeros(len(tag_m))]), reference.quat_xyzw)
    truth_m: Float = positions_at(t_ns, at_tag, REFERENCE_GAP_NS)[:, :2]
    return truth_m
