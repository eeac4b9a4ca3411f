"""The picture of the table planning-1: ways of A* and IA* beside the straight line from start to goal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.mapping.inflation import INFLATIONS
from quadlog.messages import Float
from quadlog.pipelines.tables.planner_walks import Preset, forest_of
from quadlog.pipelines.tables.route_lengths import NAMES, Pair
from quadlog.results.plots import style
from quadlog.simulation.clearance import occupied_centres
from quadlog.simulation.planning_worlds import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 4
SHOWN_ASIDE_M = 2.2


def draw_routes(pairs: list[Pair], preset: Preset, density: float, seed: int) -> Figure:
    """The first SHOWN pairs, a panel for each, with the line from start to goal as its axis."""
    count = min(SHOWN, len(pairs))
    figure = style.new_figure(1.8 * count)
    panels = figure.subplots(count, 1, sharey=True, squeeze=False).ravel()
    for number, panel in enumerate(panels):
        world = forest_of(density, number, preset, seed)
        grown = INFLATIONS[world.dilation](world.occupied, world.dilation_m / world.window.cell_m)
        for cells, color, label in ((grown, style.LIGHT, "growth"), (world.occupied, style.GREY, "trunk")):
            along_m, aside_m = beside_line(occupied_centres(cells, world.window), world).T
            panel.plot(along_m, aside_m, "s", color=color, markersize=2.4, label=label, zorder=style.ABOVE_GRID)
        for name, color, walk in zip(NAMES, (style.ROBOT, style.TARGET), pairs[number].pursued, strict=True):
            along_m, aside_m = beside_line(walk.path_xy_m, world).T
            panel.plot(along_m, aside_m, color=color, label=name)
        length_m = float(np.hypot(*(world.goal.at(0) - world.start_xy_m)))
        panel.set(xlim=(-0.5, length_m + 0.5), ylim=(-SHOWN_ASIDE_M, SHOWN_ASIDE_M), ylabel="aside (m)")
        lengths = ", ".join(
            f"{name} {walk.length_m:.2f} m" for name, walk in zip(NAMES, pairs[number].pursued, strict=True)
        )
        panel.set_title(f"walk {number + 1}: {lengths}")
    panels[-1].set_xlabel("along the straight line from start to goal (m)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), markerscale=2.0)
    return figure


def beside_line(points_m: Float, world: World) -> Float:
    """Points (N, 2) of map as (along, aside) the line from start to goal, to the left positive."""
    line_m = world.goal.at(0) - world.start_xy_m
    ahead = line_m / np.hypot(*line_m)
    axes = np.stack([ahead, [-ahead[1], ahead[0]]], axis=1)
    turned: Float = (points_m - world.start_xy_m) @ axes
    return turned
