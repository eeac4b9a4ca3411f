"""Which UWB tag is whose, where it sits on the robot, and how far its positions are from a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quadlog.config.schema import Config
from quadlog.geometry import base_to_tag, yaw_from_quat
from quadlog.messages import Float, Int, PoseSeries
from quadlog.metrics.positioning import Trajectory, positions_at
from quadlog.positioning.dilution import DilutionMap, map_dilution, radius_95

if TYPE_CHECKING:
    from quadlog.positioning.locate import Located, TagResult


def roles_of(config: Config, tags: list[int]) -> dict[str, int]:
    """Role -> tag id: as the table says; without one the lowest id is the robot, the next one the person."""
    if config.uwb.tags:
        return {tag.role: tag.id for tag in reversed(config.uwb.tags) if tag.role != "none" and tag.id in tags}
    return dict(zip(("robot", "person"), sorted(tags), strict=False))


def body_tags_of(config: Config, tags: list[int]) -> list[int]:
    """The tags among these that the robot carries, in the table's order; several are one body."""
    if config.uwb.tags:
        return [tag.id for tag in config.uwb.tags if tag.role == "robot" and tag.id in tags]
    return sorted(tags)[:1]


def lever_of(config: Config, tag: int) -> tuple[float, float]:
    """Where a tag sits in base, x_m and y_m; at its origin unless the table says otherwise."""
    row = next((each for each in config.uwb.tags if each.id == tag), None)
    return (row.x_m, row.y_m) if row is not None else (0.0, 0.0)


REFERENCE_GAP_NS = 100_000_000


def levers_on_robot(config: Config, robot_tag: int | None) -> dict[int, tuple[float, float]]:
    """Tag -> where it sits in base, x_m and y_m: the robot's, and further tags whose table gives them such a place."""
    levers = {} if robot_tag is None else {robot_tag: (0.0, 0.0)}
    for tag in config.uwb.tags:
        on_robot = tag.role == "robot" and robot_tag is not None
        if on_robot or (tag.role == "none" and (tag.x_m, tag.y_m) != (0.0, 0.0)):
            levers[tag.id] = (tag.x_m, tag.y_m)
    return levers


def tag_truth(t_ns: Int, reference: PoseSeries, lever_m: tuple[float, float]) -> Float:
    """(N, 2) where a tag with that place in base was in map at t_ns (N,), NaN where the reference is silent."""
    yaw_rad = yaw_from_quat(reference.quat_xyzw)
    tag_m = base_to_tag(reference.position_m[:, :2], yaw_rad, *lever_m)
    at_tag = Trajectory(reference.t_ns, np.column_stack([tag_m, np.zeros(len(tag_m))]), reference.quat_xyzw)
    truth_m: Float = positions_at(t_ns, at_tag, REFERENCE_GAP_NS)[:, :2]
    return truth_m


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """Positions less the truth at those N instants that have one.

    t_ns: (N,); error_m: (N, 2); bound_m: (N,) how far the claimed 95 % ellipse reaches in the error's direction.
    """

    t_ns: Int
    error_m: Float
    bound_m: Float

    @property
    def distance_m(self) -> Float:
        """(N,) length of the error."""
        length_m: Float = np.hypot(self.error_m[:, 0], self.error_m[:, 1])
        return length_m


@dataclass(frozen=True, slots=True)
class TagErrors:
    """One tag on the robot against the reference: its fixes and its track."""

    fixes: PositionErrors
    track: PositionErrors


def errors_of_tags(
    located: Located, levers_m: Mapping[int, tuple[float, float]], reference: PoseSeries | None
) -> dict[int, TagErrors]:
    """Tag -> errors, for the tags that sit on the robot; empty without a reference."""
    if reference is None or len(reference) == 0:
        return {}
    return {
        result.tag: TagErrors(*_errors_of_tag(result, levers_m[result.tag], reference))
        for result in located.tags
        if result.tag in levers_m
    }


def _errors_of_tag(
    result: TagResult, lever_m: tuple[float, float], reference: PoseSeries
) -> tuple[PositionErrors, PositionErrors]:
    fixes, solved, track = result.fixes, result.fixes.solved, result.track
    of_fixes = _errors(
        result.fix_t_ns[solved], fixes.position_m[solved], fixes.covariance_m2[solved], lever_m, reference
    )
    return of_fixes, _errors(track.t_ns, track.position_m, track.covariance_m2, lever_m, reference)


def _errors(
    t_ns: Int, position_m: Float, covariance_m2: Float, lever_m: tuple[float, float], reference: PoseSeries
) -> PositionErrors:
    error_m = position_m - tag_truth(t_ns, reference, lever_m)
    known = np.isfinite(error_m).all(axis=1)
    return PositionErrors(t_ns[known], error_m[known], radius_95(covariance_m2[known], error_m[known]))


def dilution_of(
    located: Located, tag: int | None, config: Config, max_rows: int, max_columns: int
) -> DilutionMap | None:
    """HDOP of that tag, or the first one without it, over the anchors it was heard by; None without ranges."""
    ranked = sorted(located.tags, key=lambda result: result.tag != tag)
    chosen = next((result for result in ranked if len(result.ranges.anchor)), None)
    if chosen is None:
        return None
    heard = set(np.unique(chosen.ranges.anchor).tolist())
    anchors_m = np.array([(each.x_m, each.y_m, each.z_m) for each in config.uwb.anchors if each.id in heard])
    return map_dilution(anchors_m, chosen.height_m, chosen.track.position_m, max_rows, max_columns)
