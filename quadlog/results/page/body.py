"""Tables of a run's page about its logged body and the re-simulated one."""

from __future__ import annotations

import math
from typing import Any

from quadlog.metrics.body import JOINTS, LEGS
from quadlog.results.plots.body import BODIES, at_same_speeds
from quadlog.results.plots.run_data import RunData, Table
from quadlog.results.run.tables import DUTY_FACTORS

_SPEEDS = {"all": "", "shared": ", same speeds"}
_GAIT = (
    ("speed (m/s)", "speed_mps"),
    ("stride frequency (Hz)", "stride_frequency_hz"),
    *((f"duty factor {leg}", name) for leg, name in zip(LEGS, DUTY_FACTORS, strict=True)),
    ("cost of transport", "cost_of_transport"),
    ("height, mean (m)", "height_mean_m"),
    ("height, std (m)", "height_std_m"),
    ("pitch, mean (rad)", "pitch_mean_rad"),
    ("pitch, std (rad)", "pitch_std_rad"),
)
_PHASES = ("stance", "swing")


def body_tables(data: RunData) -> dict[str, Any]:
    """Template values gait and joints, each with heads and rows; None where the run has no such table.

    A number that does not exist is None.
    """
    gait, torques = data.table("gait"), data.table("body")
    return {"gait": None if gait is None else _gait(gait), "joints": None if torques is None else _joints(torques)}


def _gait(gait: Table) -> dict[str, Any]:
    keys = zip(gait["body"], gait["speeds"], strict=True)
    heads = [BODIES.get(body, body) + _SPEEDS.get(speeds, f", {speeds}") for body, speeds in keys]
    return {"heads": heads, "rows": [(words, [_known(value) for value in gait[name]]) for words, name in _GAIT]}


def _joints(saved: Table) -> dict[str, Any]:
    """A column for each body, phase and statistic: rms and peak."""
    torques = at_same_speeds(saved)
    keys = zip(torques["body"], torques["phase"], torques["joint"], strict=True)
    values = zip(torques["torque_rms_nm"], torques["torque_peak_nm"], strict=True)
    found = dict(zip(keys, values, strict=True))
    columns = [(body, phase) for phase in _PHASES for body in BODIES if body in torques["body"]]
    unknown = (math.nan, math.nan)
    rows = [
        (joint, [_known(value) for column in columns for value in found.get((*column, joint), unknown)])
        for joint in JOINTS
    ]
    return {"heads": [f"{phase}, {BODIES[body]}" for body, phase in columns], "rows": rows}


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
