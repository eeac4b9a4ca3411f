"""Torques of the logged body beside those of the re-simulated one, by joint and gait phase."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.metrics.body import JOINTS, PHASES
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BODIES = {"logged": "logged", "resimulated": "re-simulated"}
"""Words for the column body of body.parquet and gait.parquet."""
_COLORS = {"logged": style.ROBOT, "resimulated": style.RESIM}
_BAR = 0.38


def at_same_speeds(table: Table) -> Table:
    """The rows over the speeds that both bodies walked at; over all speeds where there are no such rows."""
    speeds = "shared" if (table["speeds"] == "shared").any() else "all"
    chosen = table["speeds"] == speeds
    return {name: column[chosen] for name, column in table.items()}


def draw_body_torques(run: RunData) -> Figure | None:
    """Rms (bars) and peak (lines) of each joint's torque while its leg stands, while it swings, and at all times."""
    saved = run.table("body")
    if saved is None:
        return None
    torques = at_same_speeds(saved)
    known_joint = np.isin(torques["joint"], JOINTS)
    figure, grid = style.new_stack(len(PHASES), 1.9, above_in=0.3)
    for panel, phase in zip(grid[:, 0], PHASES, strict=True):
        for place, body in enumerate(BODIES):
            of_body = known_joint & (torques["body"] == body) & (torques["phase"] == phase)
            joint = np.array([JOINTS.index(name) for name in torques["joint"][of_body]])
            if not len(joint):
                continue
            x, rms_nm, peak_nm = (
                joint + _BAR * (place - 0.5),
                *(torques[name][of_body] for name in ("torque_rms_nm", "torque_peak_nm")),
            )
            panel.bar(x, rms_nm, _BAR, color=_COLORS[body], label=f"{BODIES[body]}: rms (bar), peak (line)")
            panel.plot(x, peak_nm, "_", color=_COLORS[body], markersize=11, markeredgewidth=2)
            panel.vlines(x, rms_nm, peak_nm, color=_COLORS[body], linewidth=0.8)
        panel.set_ylabel(f"{phase}: τ (N·m)")
        panel.set_ylim(bottom=0)
        panel.grid(visible=False, axis="x")
    style.legend_above(grid[0, 0])
    grid[-1, 0].set_xticks(range(len(JOINTS)), JOINTS, fontsize=8)
    grid[-1, 0].set_xlabel("joint (FL: front left … RR: rear right)")
    return figure
