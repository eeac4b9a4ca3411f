"""Pictures of the tracking tables: the error along single walks, and the mean error of every walk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from quadlog.pipelines.tables.tracked_walks import Tracked
from quadlog.pipelines.tables.tracking_figures import ETA, mean_interval
from quadlog.results.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TICKS_M = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
Panels = Mapping[str, Mapping[str, Sequence[Tracked]]]
"""By a panel's title and by how was walked: the walks, in the order of their seeds."""


def draw_errors(panels: Panels) -> Figure:
    """The distance to the path over time, of the first walk of each; a cross where it fell."""
    figure = style.new_figure(0.6 + 2.4 * len(panels))
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for panel, (title, ways) in zip(axes, panels.items(), strict=True):
        for color, (name, walks) in zip(style.SERIES, ways.items(), strict=False):
            walk = walks[0]
            keep = style.thin_line(walk.error_m)
            panel.plot(walk.t_s[keep], walk.error_m[keep], color=color, label=name, linewidth=1.0)
            if walk.of("fallen") == 1:
                panel.plot(walk.t_s[-1:], walk.error_m[-1:], "x", color=color, markersize=9, markeredgewidth=2)
        panel.set_title(title, pad=20)
        panel.set_ylabel("distance to path (m)")
        panel.set_ylim(bottom=0)
        style.legend_above(panel)
    axes[-1].set_xlabel("time (s)")
    return figure


def draw_etas(panels: Panels) -> Figure:
    """A panel each: a dot for each walk's η, hollow where it fell, and the mean with its 95 % interval."""
    most = max((list(ways) for ways in panels.values()), key=len)
    rows = len(most)
    figure = style.new_figure(1.0 + 0.45 * rows)
    axes = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for panel, (title, ways) in zip(axes, panels.items(), strict=True):
        for row, (color, walks) in enumerate(zip(style.SERIES, ways.values(), strict=False)):
            _draw_row(panel, row, color, walks)
        panel.set_yticks(range(rows), most)
        panel.set_ylim(rows - 0.5, -0.5)
        panel.tick_params(axis="y", length=0)
        panel.set_xscale("log")
        panel.set_xticks(TICKS_M, [f"{tick:g}" for tick in TICKS_M])
        panel.minorticks_off()
        panel.set_xlabel("η (m)")
        panel.set_title(title)
    return figure


def _draw_row(panel: Axes, row: int, color: str, walks: Sequence[Tracked]) -> None:
    eta_m = ETA.of(walks)
    fell = np.array([walk.of("fallen") == 1 for walk in walks])
    for mine, face in ((~fell, color), (fell, "white")):
        at = row + 0.18 + np.zeros(mine.sum())
        panel.plot(eta_m[mine], at, "o", color=color, markerfacecolor=face, markersize=4, alpha=0.7)
    mean, interval = mean_interval(eta_m)
    low, high = interval or (mean, mean)
    # A logarithmic axis has no place for 0, where the interval of two very different walks may begin.
    low = max(low, 0.2 * float(eta_m.min()))
    panel.plot([low, high], [row - 0.12] * 2, color=style.BLACK, linewidth=1.2)
    panel.plot([mean], [row - 0.12], "|", color=style.BLACK, markersize=10, markeredgewidth=2)
