"""The joints of the logged body: joints.parquet, and whether the feet are in the order that they are taken to be in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.messages import Float, Int, JointSeries
from quadlog.pipelines.journal import Journal
from quadlog.positioning.leg_odometry import better_foot_order
from quadlog.results.tables import CONTACTS, FOOT_FORCES, JOINT_COLUMNS, TABLES, TableWriter

if TYPE_CHECKING:
    from quadlog.pipelines.log import LogData

BATCH_ROWS = 16384


def write_joints(folder: Path, data: LogData, journal: Journal) -> None:
    """Writes joints.parquet where the log has joints; warns where its feet seem to be swapped."""
    joints = data.streams.joints
    if joints is None:
        return
    journal.use("joints")
    journal.count("joint_states", len(joints))
    _warn_of_swapped_feet(data, journal, joints)
    with TableWriter(folder / "joints.parquet", TABLES["joints"]) as table:
        for begin in range(0, len(joints), BATCH_ROWS):
            rows = slice(begin, begin + BATCH_ROWS)
            contacts = {} if data.legs is None else dict(zip(CONTACTS, data.legs.contact[rows].T, strict=True))
            table.append(_columns(joints, rows) | contacts)


def _columns(joints: JointSeries, rows: slice) -> dict[str, Float | Int]:
    columns: dict[str, Float | Int] = {"t_ns": joints.t_ns[rows]}
    for names, values in zip(
        JOINT_COLUMNS, (joints.position_rad, joints.velocity_radps, joints.torque_nm), strict=True
    ):
        columns |= zip(names, values[rows].T, strict=True)
    return columns | dict(zip(FOOT_FORCES, joints.foot_force_n[rows].T, strict=True))


def _warn_of_swapped_feet(data: LogData, journal: Journal, joints: JointSeries) -> None:
    better = better_foot_order(joints.position_rad, joints.foot_force_n)
    used = data.log.recording.joints.used.get(data.log.roles.topic("joints") or "")
    if better is None or used is None or used.feet is None:
        return
    places = ",".join(str(used.feet[foot]) for foot in better)
    journal.warn(
        "joints: the foot forces contradict the legs: feet press while their legs lift them; they would fit in the "
        f"order  --set robot.feet=[{places}]"
    )
