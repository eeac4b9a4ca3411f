"""What the search cost at each replan [Planning, Fig. 18]."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_expanded(run: RunData) -> Figure | None:
    """Cells expanded and generated per replan over time; replans from scratch and failed ones are marked."""
    walks = [("logged walk", run.table("plans")), ("re-simulated walk", run.table("resim_plans"))]
    present = [(name, plans) for name, plans in walks if plans is not None]
    if not present:
        return None
    figure, grid = style.new_stack(len(present), 2.6, above_in=0.6)
    panels = grid[:, 0]
    for panel, (name, plans) in zip(panels, present, strict=True):
        _draw_walk(run, panel, name, plans)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw_walk(run: RunData, panel: Axes, name: str, plans: Table) -> None:
    seconds = run.seconds(plans["t_ns"])
    for column, color, width in (("generated", style.FIX, 1.0), ("expanded", style.ROBOT, 1.4)):
        keep = style.thin_line(plans[column])
        panel.plot(seconds[keep], plans[column][keep], color=color, linewidth=width, label=column)
    scratch = plans["from_scratch"].astype(bool)
    failed = ~plans["found"].astype(bool)
    panel.plot(
        seconds[scratch],
        plans["expanded"][scratch],
        "o",
        color=style.TARGET,
        markersize=4.5,
        markerfacecolor="none",
        markeredgewidth=1.1,
        label="from scratch",
    )
    if failed.any():
        panel.plot(
            seconds[failed],
            np.zeros(int(failed.sum())),
            "x",
            color=style.BLACK,
            markersize=6,
            clip_on=False,
            label="no path found",
        )
    panel.set_ylim(bottom=0)
    panel.set_ylabel("cells per replan (count)")
    planners = ", ".join(sorted({str(planner) for planner in plans["planner"]}))
    panel.set_title(
        f"{name}, {planners}: {style.count(len(seconds))} replans, "
        f"{style.count(int(plans['expanded'].sum()))} cells expanded, "
        f"{style.count(int(scratch.sum()))} from scratch",
        pad=22,
    )
    style.legend_above(panel)
