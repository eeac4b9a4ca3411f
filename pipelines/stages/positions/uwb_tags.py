"""UWB tags: whose they are and where they sit, several on the robot as one body, and errors against a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from quadlog.config.schema import Config
from quadlog.geometry import base_to_tag, yaw_from_quat
from quadlog.messages import Float, Int, PoseSeries
from quadlog.metrics.positioning import positions_at
from quadlog.positioning.ellipses import radius_95
from quadlog.recordings.formatting import listed

if TYPE_CHECKING:  # what locates takes half a second to load, and `quadlog metrics` needs none of it
    from quadlog.pipelines.stages.journal import Journal
    from quadlog.positioning.body import LocatedBody
    from quadlog.positioning.locate import Anchors, Located
    from quadlog.positioning.odometry import BodyMotion, MeasuredMotion
    from quadlog.positioning.settings import LocateSettings


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
    return positions_at(t_ns, reference.t_ns, tag_m, REFERENCE_GAP_NS)


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


def errors_of_tags(
    located: Located, levers_m: Mapping[int, tuple[float, float]], reference: PoseSeries | None
) -> dict[int, dict[str, PositionErrors]]:
    """Tag -> errors of its `fixes` and its `track`, for the tags that sit on the robot; empty without a reference."""
    if reference is None or len(reference) == 0:
        return {}
    found = {}
    for result in (each for each in located.tags if each.tag in levers_m):
        fixes, solved, track, of = result.fixes, result.fixes.solved, result.track, (levers_m[result.tag], reference)
        found[result.tag] = {
            "fixes": _errors(result.epochs.t_ns[solved], fixes.position_m[solved], fixes.covariance_m2[solved], *of),
            "track": _errors(track.t_ns, track.position_m, track.covariance_m2, *of),
        }
    return found


def _errors(
    t_ns: Int, position_m: Float, covariance_m2: Float, lever_m: tuple[float, float], reference: PoseSeries
) -> PositionErrors:
    error_m = position_m - tag_truth(t_ns, reference, lever_m)
    known = np.isfinite(error_m).all(axis=1)
    return PositionErrors(t_ns[known], error_m[known], radius_95(covariance_m2[known], error_m[known]))


def solve_body(
    config: Config,
    located: Located,
    robot: list[int],
    anchors: Anchors,
    settings: LocateSettings,
    motion: BodyMotion | None,
) -> tuple[Located, LocatedBody]:
    """The robot's tags together: their results with the body's track at the place of each tag, and that track."""
    from quadlog.positioning.body import locate_body

    by_id = {result.tag: result for result in located.tags}
    levers_m = np.array([lever_of(config, tag) for tag in robot])
    body = locate_body([by_id[tag] for tag in robot], levers_m, anchors, settings, motion)
    by_id |= {result.tag: result for result in body.tags}
    return replace(located, tags=tuple(by_id[result.tag] for result in located.tags)), body


def tell_body(journal: Journal, body: LocatedBody) -> None:
    """What was taken for one body, and what in its table the ranges contradict."""
    names = listed([result.tag for result in body.tags])
    journal.note(f"tags {names} are one body: one track from the ranges of all of them")
    if body.yaw is None:
        journal.warn(
            f"tags {names} have the same lever arm (x_m and y_m in [[uwb.tags]]), so they show no yaw; if they sit "
            "apart, set their lever arms"
        )
    if body.velocity is not None:
        journal.note(velocity_words(body.velocity, "the track of the body"))
    for tag, (given_m, found_m, apart_m) in body.misplaced.items():
        journal.warn(
            f"tag {tag}: its ranges place it at x_m = {found_m[0]:.2f}, y_m = {found_m[1]:.2f} in base, "
            f"{apart_m:.2f} m from its lever arm ({given_m[0]:.2f}, {given_m[1]:.2f}); position and "
            f"yaw are wrong if the lever arms of tags {names} are: check order, signs and x against y in [[uwb.tags]]"
        )


def velocity_words(velocity: MeasuredMotion, track: str) -> str:
    """Whether velocities of another sensor steady a track by UWB, and how well they are known."""
    if velocity.reason:
        return f"velocities by {velocity.source} do not steady {track}: {velocity.reason}"
    return f"velocities by {velocity.source} steady {track}, known to {velocity.typical_std_mps:.2f} m/s"


def tell_roles(config: Config, journal: Journal, located: Located) -> None:
    """Tags of the table that never range; without a table, tags that have no role or seem to sit on one body."""
    from quadlog.positioning.body import keep_distance

    tags = [result.tag for result in located.tags]
    table = config.uwb.tags
    silent = [tag.id for tag in table if tag.role != "none" and tag.id not in tags]
    if silent:
        journal.warn(f"tags with a role in [[uwb.tags]] that never range: {listed(silent)}")
    roles = roles_of(config, tags).values()
    idle = sorted(tag for tag in tags if tag not in roles)
    if idle and not table:
        journal.note(f"tags without a role: {listed(idle)}; not used for robot or target: add [[uwb.tags]]")
    first, *others = sorted(located.tags, key=lambda result: result.tag)
    same = [each.tag for each in others if keep_distance(first.track, each.track)]
    if same and not table:
        rows = ", ".join(f'{{id = {tag}, role = "robot", x_m = 0.0, y_m = 0.0}}' for tag in (first.tag, *same))
        journal.warn(
            f"tags {listed([first.tag, *same])} keep their distance, as on one body: if the robot carries them, give "
            f"their places in base below [uwb]: tags = [{rows}]"
        )
