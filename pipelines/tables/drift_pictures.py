"""Pictures of the table foot-drift: two robots' walks over time, and how much each robot drifts with each curve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.pipelines.tables.drift_rows import DRIFT
from quadlog.pipelines.tables.drift_study import SWEPT_ROBOTS, Study
from quadlog.pipelines.tables.drift_walks import BASELINE, DERIVED, ROBOTS, Curve, Task
from quadlog.results.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WAYS = {"without y(t)": BASELINE, "derived y(t)": DERIVED}
PRINTED_MM = (280.0, 40.0)
LEAST_MM = 0.5


def draw_walks(study: Study) -> Figure:
    """Place aside and yaw over time, a column for each robot."""
    figure = style.new_figure(5.0)
    panels = figure.subplots(2, len(SWEPT_ROBOTS), sharex=True, sharey="row")
    for column, robot in zip(panels.T, SWEPT_ROBOTS, strict=True):
        for color, (name, curve) in zip(style.SERIES, WAYS.items(), strict=False):
            walk = study.drifts[Task(robot, curve, study.seeds[0])]
            column[0].plot(walk.t_s, 1e3 * walk.y_m, color=color, linewidth=1.0, label=name)
            column[1].plot(walk.t_s, np.degrees(walk.yaw_rad), color=color, linewidth=1.0)
        column[0].set_title(robot, pad=20)
        column[1].set_xlabel("time (s)")
    style.legend_above(panels[0, 0])
    panels[0, 0].set_ylabel("y, to the left (mm)")
    panels[1, 0].set_ylabel("yaw (°)")
    figure.align_ylabels()
    return figure


def draw_sizes(study: Study) -> Figure:
    """A row for each robot, in it a line of dots for each curve."""
    figure = style.new_figure(1.2 + 0.62 * len(ROBOTS))
    panel = figure.subplots()
    ways = {name: dict.fromkeys(ROBOTS, curve) for name, curve in WAYS.items()}
    for place, name in enumerate(("alternating, chosen", "same side, chosen") if study.chosen else ()):
        ways[name] = {robot: curves[place] for robot, curves in study.chosen.items()}
    for number, (color, (name, curves)) in enumerate(zip(style.SERIES, ways.items(), strict=False)):
        offset = 0.18 * (number - (len(ways) - 1) / 2)
        for row, robot in enumerate(ROBOTS):
            sizes_mm = _sizes_mm(study, robot, curves[robot])
            at = np.full(len(sizes_mm), row + offset)
            panel.plot(sizes_mm, at, "o", color=color, markersize=3.5, alpha=0.55, label=None if row else name)
            panel.plot([sizes_mm.mean()], at[:1], "|", color=color, markersize=9, markeredgewidth=2.2)
    for printed in PRINTED_MM:
        panel.axvline(printed, color=style.GREY, linewidth=0.9, linestyle="--")
    panel.set_yticks(range(len(ROBOTS)), list(ROBOTS))
    panel.set_ylim(len(ROBOTS) - 0.5, -0.5)
    panel.tick_params(axis="y", length=0)
    panel.set_xscale("log")
    panel.set_xlabel("size of the drift after 30 s (mm)")
    style.legend_above(panel)
    return figure


def _sizes_mm(study: Study, robot: str, curve: Curve) -> np.ndarray:
    """(N,) a logarithmic axis has no place for 0."""
    return np.maximum(DRIFT.of(study.drifts, robot, curve, study.seeds), LEAST_MM)
