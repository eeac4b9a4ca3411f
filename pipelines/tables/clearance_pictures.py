"""The picture of the table planning-ea: ways round obstacles by number of rings, on the cells where they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.kept_clearance import FORMS, RINGS, SHOWN, ends_of, planners_of
from quadlog.pipelines.tables.planner_walks import Preset
from quadlog.results.plots import style
from quadlog.simulation.planning_scenes import SCENES
from quadlog.simulation.planning_worlds import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKS = ("+", "o", "x", "*")
"""Of A* and of one, two and three rings, as in Fig. 19."""
AROUND_M = 1.6


def draw_clearances(preset: Preset) -> Figure:
    """A row of panels per scene, a column per form of EA*."""
    figure = style.new_figure(6.4)
    panels = figure.subplots(len(SHOWN), len(FORMS), squeeze=False)
    planners = planners_of(preset)
    for row, (scene, called) in zip(panels, SHOWN.items(), strict=True):
        world = SCENES[scene]()
        for panel, form in zip(row, FORMS, strict=True):
            chosen = {"A*": preset.baseline} | {f"n = {n}": f"{form}, n = {n}" for n in RINGS}
            plans = {label: planners[name].plan(world.occupied, *ends_of(world)) for label, name in chosen.items()}
            _draw_scene(panel, world, {label: world.window.centre_of(plan.cells) for label, plan in plans.items()})
            panel.set_title(f"{called}: {form}")
    for panel in panels[-1]:
        panel.set_xlabel("x (m)")
    for panel in panels[:, 0]:
        panel.set_ylabel("y (m)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), markerscale=1.8)
    return figure


def _draw_scene(panel: Axes, world: World, paths: dict[str, Float]) -> None:
    left, bottom = world.window.origin_m.tolist()
    rows, cols = world.window.shape
    extent = (left, left + cols * world.window.cell_m, bottom, bottom + rows * world.window.cell_m)
    look = {"cmap": "Greys", "vmin": 0, "vmax": 1.3, "zorder": style.ABOVE_GRID}
    panel.imshow(world.occupied, origin="lower", extent=extent, **look)  # type: ignore[arg-type]
    colors = (style.BLACK, style.ROBOT, style.TARGET, style.PLAN)
    for (label, path), mark, color in zip(paths.items(), MARKS, colors, strict=True):
        hollow = "none" if mark == "o" else color
        panel.plot(*path.T, mark, color=color, label=label, markersize=2.8, markeredgewidth=0.7, markerfacecolor=hollow)
        panel.plot(*path.T, color=color, linewidth=0.7)
    every = np.concatenate(list(paths.values()))
    low, high = every.min(axis=0) - AROUND_M, every.max(axis=0) + AROUND_M
    panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    panel.grid(visible=False)
