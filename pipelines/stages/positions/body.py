"""Several tags on the robot: solved as one body, with notes and warnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.config.schema import Config
from quadlog.pipelines.journal import Journal
from quadlog.pipelines.stages.positions.tag_errors import lever_of, roles_of
from quadlog.positioning.body.locate_body import LocatedBody, keep_distance, locate_body
from quadlog.positioning.heading.odometry_velocity import BodyMotion, MeasuredVelocity
from quadlog.positioning.locate import Anchors, Located, LocateSettings
from quadlog.recordings.formatting import listed


def solve_body(
    config: Config,
    located: Located,
    robot: list[int],
    anchors: Anchors,
    settings: LocateSettings,
    motion: BodyMotion | None,
) -> tuple[Located, LocatedBody]:
    """The robot's tags together: their results with the body's track at the place of each, and that track."""
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
    for each in body.misplaced:
        journal.warn(
            f"tag {each.tag}: its ranges place it at x_m = {each.found_m[0]:.2f}, y_m = {each.found_m[1]:.2f} in base, "
            f"{each.distance_m:.2f} m from its lever arm ({each.given_m[0]:.2f}, {each.given_m[1]:.2f}); position and "
            f"yaw are wrong if the lever arms of tags {names} are: check order, signs and x against y in [[uwb.tags]]"
        )


def velocity_words(velocity: MeasuredVelocity, track: str) -> str:
    """Whether velocities of another sensor steady a track by UWB, and how well they are known."""
    if velocity.series is None:
        return f"velocities by {velocity.source} do not steady {track}: {velocity.reason}"
    return f"velocities by {velocity.source} steady {track}, known to {velocity.std_mps:.2f} m/s from the log"


def tell_roles(config: Config, journal: Journal, located: Located) -> None:
    """Tags of the table that never range; without a table, tags that have no role or seem to sit on one body."""
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
