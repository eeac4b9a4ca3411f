"""The logged body beside the re-simulated one, from a run's saved tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quadlog.config.schema import Config
from quadlog.messages import Float
from quadlog.metrics.body import (
    BodySeries,
    Gait,
    gait,
    ground_speed,
    same_speed,
    stance_by_force,
    stance_by_weight,
    torque_rows,
)
from quadlog.metrics.metric import Metric, Metrics
from quadlog.results.run.tables import (
    CONTACTS,
    DUTY_FACTORS,
    JOINT_COLUMNS,
    TABLES,
    TableWriter,
    has_table,
    read_table,
)

if TYPE_CHECKING:
    from quadlog.positioning.leg_odometry import LegGeometry
    from quadlog.simulation.robot.height_field import HeightField

_RATES, _TORQUES = JOINT_COLUMNS[1], JOINT_COLUMNS[2]


@dataclass(frozen=True, slots=True)
class KnownBody:
    """The robot that both bodies are, as the configuration says: its mass and legs."""

    mass_kg: float
    geometry: LegGeometry


def known_body(config: Config) -> KnownBody | None:
    """None where no robot is configured: its mass and legs would be a guess. Raises UnknownName and UnusableRobot."""
    if not config.robot.model_fields_set & {"model", "preset"}:
        return None
    from quadlog.pipelines.stages.positions.legs import robot_of
    from quadlog.positioning.leg_odometry import LegGeometry

    robot = robot_of(config)
    return KnownBody(robot.mass_kg, LegGeometry(robot.hips_m, robot.lengths_m, robot.foot_radius_m))


def logged_body(run: Path, geometry: LegGeometry | None = None) -> BodySeries:
    """From joints.parquet and poses.parquet; geometry: of the legs, for the height. Raises NotARun."""
    poses = read_table(run, "poses", ["t_ns", "x_m", "y_m", "roll_rad", "pitch_rad"])
    t_ns = read_table(run, "joints", ["t_ns"])["t_ns"]
    # Leg by leg: at 1 kHz a whole table of an hour would be 1 GB.
    torque_nm, power_w = np.empty((len(t_ns), 12), np.float32), np.zeros(len(t_ns))
    for leg in range(4):
        joints = slice(3 * leg, 3 * leg + 3)
        names = (*_TORQUES[joints], *_RATES[joints])
        columns = read_table(run, "joints", names)
        leg_torque_nm, rates_radps = (
            np.column_stack([columns[name] for name in part]) for part in (names[:3], names[3:])
        )
        torque_nm[:, joints] = leg_torque_nm
        power_w += np.abs(leg_torque_nm * rates_radps).sum(axis=1)
    weights = np.column_stack(list(read_table(run, "joints", CONTACTS).values()))
    tilt_rad = [np.interp(t_ns, poses["t_ns"], poses[name], np.nan, np.nan) for name in ("roll_rad", "pitch_rad")]
    stance = stance_by_weight(t_ns, weights)
    return BodySeries(
        t_ns=t_ns,
        speed_mps=ground_speed(t_ns, poses["t_ns"], np.column_stack([poses["x_m"], poses["y_m"]])),
        torque_nm=torque_nm,
        stance=stance,
        power_w=power_w,
        height_m=np.full(len(t_ns), np.nan) if geometry is None else _height(run, geometry, stance, *tilt_rad),
        pitch_rad=tilt_rad[1],
    )


def resimulated_body(run: Path, ground: HeightField | None = None) -> BodySeries | None:
    """From control.parquet until a fall, None for a robot without joints; ground: that it walked on. Raises NotARun.

    Its torques are those at its control's ticks; joint speeds are not saved, and its power is unknown.
    """
    forces, torques = [f"fz_{leg}_n" for leg in range(4)], list(_TORQUES)
    table = read_table(run, "control", ["t_ns", "x_m", "y_m", "z_m", "pitch_rad", "fallen", *torques, *forces])
    standing = ~table["fallen"]
    table = {name: column[standing] for name, column in table.items()}
    torque_nm = np.column_stack([table[name] for name in torques])
    if not np.isfinite(torque_nm).any():
        return None
    t_ns, xy_m = table["t_ns"], np.column_stack([table["x_m"], table["y_m"]])
    return BodySeries(
        t_ns=t_ns,
        speed_mps=ground_speed(t_ns, t_ns, xy_m),
        torque_nm=torque_nm,
        stance=stance_by_force(t_ns, np.column_stack([table[name] for name in forces])),
        power_w=np.full(len(t_ns), np.nan),
        height_m=np.full(len(t_ns), np.nan) if ground is None else table["z_m"] - ground.height_at(xy_m),
        pitch_rad=table["pitch_rad"],
    )


def _height(run: Path, geometry: LegGeometry, stance: Float, roll_rad: Float, pitch_rad: Float) -> Float:
    """(N,) of the body's origin above the soles of its standing feet; an unknown tilt is level, no foot is NaN."""
    from quadlog.positioning.leg_odometry import feet_in_body

    angles = read_table(run, "joints", JOINT_COLUMNS[0])
    feet_m = feet_in_body(np.column_stack(list(angles.values())), geometry)
    roll, pitch = (np.nan_to_num(each)[:, None] for each in (roll_rad, pitch_rad))
    across_m = np.sin(roll) * feet_m[..., 1] + np.cos(roll) * feet_m[..., 2]
    below_m = geometry.foot_radius_m + np.sin(pitch) * feet_m[..., 0] - np.cos(pitch) * across_m
    stands = (stance == 1) & np.isfinite(below_m)
    count = stands.sum(axis=1)
    return np.where(count > 0, np.where(stands, below_m, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def compare_bodies(run: Path, geometry: LegGeometry | None, ground: HeightField | None) -> dict[str, BodySeries]:
    """Logged and, where there is one with joints, resimulated. Raises NotARun."""
    bodies = {"logged": logged_body(run, geometry)}
    resimulated = resimulated_body(run, ground) if has_table(run, "control") else None
    return bodies if resimulated is None else bodies | {"resimulated": resimulated}


def write_bodies(run: Path, bodies: Mapping[str, BodySeries], mass_kg: float, resimulated_cost: float) -> Metrics:
    """Writes body.parquet and gait.parquet; the metrics that no other table gives.

    mass_kg: NaN where no robot is configured. resimulated_cost: cost of transport of its whole walk, which its tables
    do not give.
    """
    weights: dict[str, dict[str, Float | None]] = {"all": dict.fromkeys(bodies)}
    if len(bodies) == 2:
        shared = same_speed(*bodies.values())
        weights |= {} if shared is None else {"shared": dict(zip(bodies, shared, strict=True))}
    metrics: Metrics = {}
    with (
        TableWriter(run / "body.parquet", TABLES["body"]) as torques,
        TableWriter(run / "gait.parquet", TABLES["gait"]) as gaits,
    ):
        for speeds, of_bodies in weights.items():
            for name, weight in of_bodies.items():
                head = {"body": name, "speeds": speeds}
                for row in torque_rows(bodies[name], weight):
                    torques.add_row(head | row._asdict())
                walked = gait(bodies[name], mass_kg, weight)
                if speeds == "all" and name == "resimulated":
                    walked = replace(walked, cost_of_transport=resimulated_cost)
                gaits.add_row(head | _gait_row(walked))
                if speeds == "all" and name == "logged" and np.isfinite(walked.cost_of_transport):
                    metrics["logged_cost_of_transport"] = Metric(walked.cost_of_transport, walked.n, "")
    return metrics


def _gait_row(walked: Gait) -> dict[str, float | int]:
    columns = {each.name: getattr(walked, each.name) for each in fields(walked) if each.name != "duty_factor"}
    return columns | dict(zip(DUTY_FACTORS, walked.duty_factor.tolist(), strict=True))
