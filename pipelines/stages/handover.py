"""What later stages have to know of those that are done, beside their files: noted in a mark, and taken from it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from quadlog.messages import Float
from quadlog.metrics.effort import Effort
from quadlog.pipelines.stages.tracks import RobotTrack, TargetTrack
from quadlog.pipelines.stages.units import Unit
from quadlog.pipelines.stages.walk import Walk, WalkedBody, WhatWasRead
from quadlog.recordings.container import Loss
from quadlog.results.stage_marks import Marked, StageMark
from quadlog.results.tables import has_table, read_table


class _Stage(Marked):
    """What a stage took when it ran."""

    seconds: float
    peak_memory_mb: float


class _Loss(Marked):
    """See Loss."""

    cause: str
    detail: str
    topic: str | None
    count: int | None


class _Effort(Marked):
    """See Effort."""

    energy_j: float
    distance_m: float
    torque_max_nm: float
    saturation_share: float
    pitch_rms_rad: float
    height_rms_m: float


class _Body(Marked):
    """See WalkedBody."""

    mass_kg: float
    ticks: int
    effort: _Effort


class _Robot(Marked):
    """What a RobotTrack has that is in no table."""

    source: str
    frame_id: str


class Known(Marked):
    """All that a walk knew when a unit was done: what the unit found out, and those before it.

    losses, read_warnings: of the recording, as far as it was read by then. The order of all is kept.
    """

    first_ns: int
    last_ns: int
    robot: _Robot | None
    target_source: str | None
    used: dict[str, list[str]]
    counts: dict[str, int]
    notes: list[str]
    warnings: list[str]
    losses: list[_Loss]
    read_warnings: list[str]
    body: _Body | None
    stages: dict[str, _Stage]


def note_known(walk: Walk, unit: Unit) -> Known:
    """What a walk knows, now that a unit is done."""
    robot, target, body, clock = walk.robot, walk.target, walk.body, walk.clock
    return Known(
        first_ns=int(walk.first_ns),
        last_ns=int(walk.last_ns),
        robot=None if robot is None else _Robot(source=robot.source, frame_id=robot.frame_id),
        target_source=None if target is None else target.source,
        used={role: list(topics) for role, topics in walk.used.items()},
        counts={name: int(count) for name, count in walk.counts.items()},
        notes=walk.notes,
        warnings=walk.own_warnings,
        losses=[_Loss(**asdict(loss)) for loss in walk.losses],
        read_warnings=walk.read_warnings,
        body=None if body is None else _body(body),
        stages={
            name: _Stage(seconds=clock.seconds[name], peak_memory_mb=clock.peak_memory_mb[name])
            for name in unit.stages
            if name in clock.seconds
        },
    )


def known_of(mark: StageMark) -> Known | None:
    """What a mark has noted; None for one that quadlog did not write so."""
    try:
        return Known.model_validate(mark.known)
    except (ValidationError, RecursionError):
        return None


def hand_over(known: Known, unit: Unit, walk: Walk) -> None:
    """Bring a walk to where it was when the unit was done. Raises NotARun for damaged tables."""
    run, body = walk.run.path, known.body
    walk.first_ns, walk.last_ns = known.first_ns, known.last_ns
    if known.robot is not None:
        walk.robot = _read_robot(run, known.robot)
    if known.target_source is not None:
        walk.target = _read_target(run, known.target_source)
    walk.used = {role: tuple(topics) for role, topics in known.used.items()}
    walk.counts = dict(known.counts)
    walk.notes, walk.own_warnings = list(known.notes), list(known.warnings)
    walk.body = None if body is None else WalkedBody(body.mass_kg, body.ticks, Effort(**body.effort.model_dump()))
    if "filter" in unit.stages:
        losses = [Loss(**loss.model_dump()) for loss in known.losses]
        walk.read_before = WhatWasRead(losses, list(known.read_warnings))
    for name, stage in known.stages.items():
        walk.clock.seconds[name], walk.clock.peak_memory_mb[name] = stage.seconds, stage.peak_memory_mb


def _body(body: WalkedBody) -> _Body:
    effort = {name: float(value) for name, value in asdict(body.effort).items()}
    return _Body(mass_kg=float(body.mass_kg), ticks=int(body.ticks), effort=_Effort(**effort))


def _read_robot(run: Path, known: _Robot) -> RobotTrack:
    poses = read_table(run, "poses")
    xy_m = np.column_stack([poses["x_m"], poses["y_m"]])
    covariance_m2: Float | None = None
    yaw_std_rad: Float | None = None
    if has_table(run, "pose_uncertainty"):
        spread = read_table(run, "pose_uncertainty")
        xx_m2, xy_m2, yy_m2 = (spread[f"cov_{axes}_m2"] for axes in ("xx", "xy", "yy"))
        covariance_m2 = np.stack([np.stack([xx_m2, xy_m2], axis=1), np.stack([xy_m2, yy_m2], axis=1)], axis=1)
        yaw_std_rad = spread["yaw_std_rad"]
    return RobotTrack(poses["t_ns"], xy_m, poses["yaw_rad"], known.source, known.frame_id, covariance_m2, yaw_std_rad)


def _read_target(run: Path, source: str) -> TargetTrack:
    target = read_table(run, "target")
    return TargetTrack(target["t_ns"], np.column_stack([target["x_m"], target["y_m"]]), source)
