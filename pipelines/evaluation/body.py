"""The logged body beside the re-simulated one, from a run's saved tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.messages import Float, Int
from quadlog.metrics.summary import Metric, Metrics
from quadlog.metrics.walking import (
    MOST_UNEVEN,
    BodySeries,
    gait,
    ground_speed,
    stance_where,
    torque_rows,
    uneven_share,
)
from quadlog.results.tables import (
    CONTACTS,
    FOOT_FORCES,
    JOINT_COLUMNS,
    TABLES,
    TableWriter,
    has_table,
    read_table,
)

if TYPE_CHECKING:
    from quadlog.control.locomotion.robot import Robot

_, _RATES, _TORQUES = JOINT_COLUMNS
_CONTACT = 0.5


def known_robot(config: Config) -> Robot | None:
    """None where no robot is configured: its mass and legs would be a guess. Raises UnknownName and UnusableRobot."""
    from quadlog.pipelines.stages.positions.legs import robot_of

    return robot_of(config) if "model" in config.robot.model_fields_set else None


def logged_body(run: Path) -> BodySeries:
    """From joints.parquet and poses.parquet. Raises NotARun."""
    poses = read_table(run, "poses", ["t_ns", "x_m", "y_m", "pitch_rad"])
    t_ns = read_table(run, "joints", ["t_ns"])["t_ns"]
    # Leg by leg, as the whole table of an hour at 1 kHz would be 1 GB.
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
    return BodySeries(
        t_ns=t_ns,
        speed_mps=ground_speed(t_ns, poses["t_ns"], np.column_stack([poses["x_m"], poses["y_m"]])),
        torque_nm=torque_nm,
        stance=_logged_stance(run, t_ns, torque_nm),
        power_w=power_w,
        pitch_rad=np.interp(t_ns, poses["t_ns"], poses["pitch_rad"], np.nan, np.nan),
    )


def _logged_stance(run: Path, t_ns: Int, torque_nm: NDArray[np.floating]) -> Float:
    """(N, 4) of the forces of feet, as in a simulation; of contacts by torques where a foot has no sensor.

    NaN without either, and where rows come in bursts or are missing.
    """
    from quadlog.positioning.leg_odometry import CARRIES_SHARE, share_of_usual

    stance = np.full((len(t_ns), len(CONTACTS)), np.nan)
    if uneven_share(t_ns) > MOST_UNEVEN:
        return stance
    for leg, (force, contact) in enumerate(zip(FOOT_FORCES, CONTACTS, strict=True)):
        carried, least = share_of_usual(read_table(run, "joints", [force])[force][:, None]), CARRIES_SHARE
        if np.isnan(carried).all() and np.isfinite(torque_nm[:, 3 * leg : 3 * leg + 3]).any():
            carried, least = read_table(run, "joints", [contact])[contact][:, None], _CONTACT
        stance[:, [leg]] = stance_where(t_ns, carried, least)
    return stance


def resimulated_body(run: Path) -> BodySeries | None:
    """From control.parquet until a fall, None for a robot without joints. Raises NotARun.

    Its torques are those at its control's ticks, its power is the mean until the next one.
    """
    from quadlog.positioning.leg_odometry import CARRIES_SHARE, share_of_usual

    forces, torques = [f"fz_{leg}_n" for leg in range(4)], list(_TORQUES)
    table = read_table(run, "control", ["t_ns", "x_m", "y_m", "pitch_rad", "fallen", "energy_j", *torques, *forces])
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
        stance=stance_where(t_ns, share_of_usual(np.column_stack([table[name] for name in forces])), CARRIES_SHARE),
        power_w=np.append(np.diff(table["energy_j"]) / (np.diff(t_ns) * 1e-9), np.nan)[: len(t_ns)],
        pitch_rad=table["pitch_rad"],
    )


def write_bodies(run: Path, masses_kg: Mapping[str, float], resimulated_cost: float) -> Metrics:
    """Writes body.parquet and gait.parquet; the metrics that no other table gives. Raises NotARun.

    masses_kg: of the body logged and, where there is one with joints, resimulated, NaN where it is not known.
    resimulated_cost: cost of transport of its whole walk, at the rate of the simulation.
    """
    metrics: Metrics = {}
    resimulated = resimulated_body(run) if has_table(run, "control") else None
    bodies = {"logged": logged_body(run)} | ({} if resimulated is None else {"resimulated": resimulated})
    with (
        TableWriter(run / "body.parquet", TABLES["body"]) as torques,
        TableWriter(run / "gait.parquet", TABLES["gait"]) as gaits,
    ):
        for name, body in bodies.items():
            for row in torque_rows(body):
                torques.add_row({"body": name} | row)
            walked = gait(body, masses_kg[name])
            if name == "resimulated":
                walked["cost_of_transport"] = resimulated_cost
            gaits.add_row({"body": name} | walked)
            if name == "logged" and np.isfinite(cost := walked["cost_of_transport"]):
                metrics["logged_cost_of_transport"] = Metric(cost, int(body.cost_known.sum()), "")
    return metrics
