"""Planners side by side: cells per replan of an episode [Planning, Fig. 18], and how their ratios scatter."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import printable
from quadlog.messages import Float, Int
from quadlog.results.plots import style
from quadlog.results.run.maps import grid_extent_m
from quadlog.results.text.numbers import count, significant

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOG_DECADES = 2
"""Counts that span more than this are drawn on a logarithmic axis."""
MOST_RINGS = 0.5
"""Above this share of replans, rings would hide the line; the title has their number."""
SHOWN_EPISODES = 1000
_GOLDEN = (math.sqrt(5) - 1) / 2

Median = tuple[float, float | None, float | None]
"""A median ratio, and the bounds of its interval where it has one."""


def draw_cells(
    cells: Mapping[str, Int],
    from_scratch: Mapping[str, NDArray[np.bool_]],
    baseline: str,
    title: str,
    counted: str = "expanded",
) -> Figure | None:
    """Cells per replan of one episode, (R,) per planner: a panel for each, with the baseline behind it in grey.

    from_scratch: per incremental planner (R,) whether a replan started from scratch; other planners are left out.
    counted: which cells. None without replans.
    """
    shown = [name for name in cells if name != baseline] or list(cells)
    if not shown or not len(cells[shown[0]]):
        return None
    columns = 1 if len(shown) <= 3 else 2
    rows = math.ceil(len(shown) / columns)
    figure = style.new_figure(1.1 + rows * (2.4 if columns == 1 else 1.6))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for panel, name in zip(panels, shown, strict=False):
        if baseline in cells and name != baseline:
            _draw_counts(panel, cells[baseline], baseline, style.GREY, 1.0)
        label = name if len(shown) == 1 else "the planner named above"
        _draw_counts(panel, cells[name], label, style.ROBOT, 1.3)
        if name in from_scratch and np.mean(from_scratch[name]) <= MOST_RINGS:
            at = np.flatnonzero(from_scratch[name])
            style.ring(panel, at, cells[name][at])
        panel.set_title(name if name not in from_scratch else f"{name}   {_restarts(from_scratch[name])}")
    _scale_counts(panels[0], np.concatenate([cells[name] for name in cells]))
    for panel in panels[len(shown) :]:
        panel.remove()
    for panel in panels[max(0, len(shown) - columns) : len(shown)]:
        panel.set_xlabel("replan (number)")
        panel.tick_params(labelbottom=True)
    figure.supylabel(f"{'neighbours' if counted == 'touched' else 'cells'} {counted} per replan (count)", fontsize=10)
    _title(figure, title)
    entries = legend_entries(panels[: len(shown)].tolist())
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=len(entries))
    return figure


def draw_ratios(ratios: Mapping[str, Float], medians: Mapping[str, Median], baseline: str, title: str) -> Figure | None:
    """Ratios of cells per episode, (E,) per planner: points, median and interval, the best planner on top.

    A planner without a median, and the baseline itself, have no line of points. None when no planner is left.
    """
    shown = sorted((name for name in medians if name != baseline), key=lambda name: -medians[name][0])
    if not shown:
        return None
    figure = style.new_figure(1.3 + 0.42 * len(shown))
    axes = figure.subplots()
    for place, name in enumerate(shown):
        _draw_ratio_line(axes, place, ratios[name], medians[name])
    axes.axvline(1.0, color=style.BLACK, linewidth=1.0, linestyle="--", zorder=1.5)
    axes.set_yticks(range(len(shown)), shown)
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    drawn = [ratios[name][ratios[name] > 0] for name in shown]
    bounds = [value for name in shown for value in medians[name] if value]
    _scale_ratios(axes, np.concatenate([*drawn, bounds, [1.0]]))
    axes.set_xlabel(f"cells of {baseline} / cells of the planner (1); right of the dashed line is better")
    _title(figure, title)
    _ratio_legend(figure)
    return figure


def _draw_counts(panel: Axes, counts: Int, label: str, color: str, width: float) -> None:
    keep = style.thin_line(counts.astype(np.float64))
    panel.plot(keep, counts[keep], color=color, linewidth=width, label=label, alpha=0.9)


def _restarts(from_scratch: NDArray[np.bool_]) -> str:
    return f"({count(int(from_scratch.sum()))} of {count(len(from_scratch))} from scratch)"


def _scale_counts(panel: Axes, counts: Int) -> None:
    positive = counts[counts > 0]
    if len(positive) and positive.max() > 10**LOG_DECADES * positive.min():
        # Zero must be shown: a planner may search no cell if nothing changed.
        panel.set_yscale("symlog", linthresh=1.0, linscale=0.4)
        panel.set_ylim(0, 2.0 * positive.max())
        decades = range(math.ceil(math.log10(2.0 * positive.max())))
        panel.set_yticks([0, *(10**k for k in decades)])
        panel.set_yticklabels(["0", *(count(10**k) for k in decades)])
        panel.set_yticks([], minor=True)
    else:
        panel.set_ylim(bottom=0)
    panel.margins(x=0.02)


def _draw_ratio_line(axes: Axes, place: int, ratios: Float, median: Median) -> None:
    middle, low, high = median
    finite = ratios[ratios > 0]
    some = finite[style.thin_points(len(finite), SHOWN_EPISODES)]
    # Spread over the height of the line, deterministic, neighbours at different heights.
    height = place + 0.5 * ((np.arange(len(some)) * _GOLDEN) % 1 - 0.5)
    axes.plot(some, height, ".", color=style.FIX, markersize=4, alpha=0.7, zorder=2)
    color = style.GREY
    if low is not None and high is not None:
        color = style.ROBOT if low > 1 else style.TARGET if high < 1 else style.GREY
        axes.plot([low, high], [place, place], color=color, linewidth=5, alpha=0.9, solid_capstyle="butt", zorder=3)
    axes.plot([middle, middle], [place - 0.3, place + 0.3], color=color, linewidth=2.4, zorder=4)
    interval = f"  ({_short(low)} to {_short(high)})" if low is not None and high is not None else ""
    words = f"{_short(middle)}{interval}"
    axes.annotate(
        words, (1.01, place), xycoords=("axes fraction", "data"), va="center", fontsize=9, annotation_clip=False
    )


def _short(value: float) -> str:
    return count(round(value)) if value >= 100 else significant(value, 3)


def _scale_ratios(axes: Axes, values: Float) -> None:
    """Logarithmic where it has marks enough: twice and half are equally far from 1."""
    low, high = float(values.min()) / 1.08, float(values.max()) * 1.08
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [digit * 10.0**k for k in powers for digit in (1, 2, 5) if low <= digit * 10.0**k <= high]
    if len(ticks) >= 3:
        axes.set_xscale("log")
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
    axes.set_xlim(low, high)


def _ratio_legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], linestyle="none", marker=".", markersize=9, color=style.FIX, label="an episode"),
        Line2D([], [], linewidth=5, color=style.ROBOT, label="median, 95 %: fewer cells"),
        Line2D([], [], linewidth=5, color=style.TARGET, label="more cells"),
        Line2D([], [], linewidth=5, color=style.GREY, label="no difference shown"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _title(figure: Figure, title: str) -> None:
    figure.suptitle(plain(title), x=0.01, ha="left", fontsize=10.5, fontweight="bold")


def plain(text: str) -> str:
    """Text that may contain anything, as matplotlib draws it: a dollar would begin mathematics."""
    return printable(text).replace("$", r"\$")


def legend_entries(panels: Sequence[Axes]) -> dict[str, Artist]:
    """What any of the panels names, once: label -> handle."""
    entries: dict[str, Artist] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    return entries


OBSTACLE, GROWTH = "#3a3a3a", "#c4c4c4"
MAX_PIXELS = 4_000_000
LEAST_MARGIN_CELLS = 10


@dataclass(frozen=True, slots=True)
class PathScene:
    """One map and what was planned on it.

    occupied: (rows, cols) bool, row = y; grown: the same with the obstacles' growth, or None without any.
    paths: (L, 2) x, y per planner, in the order of drawing; empty where there is none.
    start, goal: (2,); cell: edge of a cell; origin: (2,) lower-left corner of the map; all in `unit`.
    y_goes_down: row 0 is the upper one, as MovingAI's maps have it.
    """

    title: str
    occupied: NDArray[np.bool_]
    grown: NDArray[np.bool_] | None
    paths: Mapping[str, Float]
    start: Float
    goal: Float
    cell: float
    origin: tuple[float, float] = (0.0, 0.0)
    unit: str = "m"
    y_goes_down: bool = False

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top, as imshow takes them."""
        return grid_extent_m(self.origin, self.occupied.shape, self.cell)


def around_paths(scene: PathScene) -> PathScene:
    """The part of the scene that its paths take, and half as much around them."""
    ends = np.array([scene.start, scene.goal])
    points = np.concatenate([ends, *(path for path in scene.paths.values() if len(path))])
    cells = (points - scene.origin) / scene.cell
    margin = max(float((cells.max(axis=0) - cells.min(axis=0)).max()) / 2, LEAST_MARGIN_CELLS)
    rows, cols = scene.occupied.shape
    left, bottom = np.floor(np.clip(cells.min(axis=0) - margin, 0, [cols, rows])).astype(int).tolist()
    right, top = np.ceil(np.clip(cells.max(axis=0) + margin, 0, [cols, rows])).astype(int).tolist()
    part = np.s_[bottom:top, left:right]
    origin_x, origin_y = scene.origin
    return replace(
        scene,
        occupied=scene.occupied[part],
        grown=None if scene.grown is None else scene.grown[part],
        origin=(origin_x + left * scene.cell, origin_y + bottom * scene.cell),
    )


def draw_paths(scene: PathScene) -> Figure:
    """The map and every planner's path; planners whose paths are the same share a line.

    Lines on the same cells are drawn beside one another, across the way from start to goal.
    """
    rows, cols = scene.occupied.shape
    figure = style.new_figure(5.2 * min(max(rows / cols, 0.3), 2.0) + 0.65)
    axes = figure.subplots()
    _draw_cells(axes, scene)
    _draw_lanes(axes, scene, figure.dpi_scale_trans)
    mark: dict[str, Any] = {"color": style.BLACK, "markeredgecolor": "white", "linestyle": "none", "zorder": 4}
    axes.plot(*scene.start, "o", markersize=9, label="start", **mark)
    axes.plot(*scene.goal, "*", markersize=15, label="goal", **mark)
    left, right, bottom, top = scene.extent
    axes.set(xlim=(left, right), ylim=(top, bottom) if scene.y_goes_down else (bottom, top), aspect="equal")
    axes.set(xlabel=f"x ({scene.unit})", ylabel=f"y ({scene.unit})")
    axes.set_title(plain(scene.title))
    axes.grid(visible=False)
    entries = legend_entries([axes])
    beside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0)}
    axes.legend(entries.values(), entries.keys(), borderaxespad=0, labelspacing=0.8, **beside)
    return figure


def same_paths(paths: Mapping[str, Float]) -> list[list[str]]:
    """The planners that have a path, in order, those together whose paths are the same."""
    groups: list[list[str]] = []
    for name, path in paths.items():
        alike = next((group for group in groups if np.array_equal(paths[group[0]], path)), None)
        if alike is not None:
            alike.append(name)
        elif len(path):
            groups.append([name])
    return groups


def _draw_lanes(axes: Axes, scene: PathScene, inches: Any) -> None:
    """A line for each group of planners. inches: the figure's transform, in which the lines are moved apart."""
    from matplotlib.transforms import ScaledTranslation

    lanes = same_paths(scene.paths)
    width = 2.0 if len(lanes) <= 4 else 1.4
    along = (np.asarray(scene.goal, np.float64) - scene.start) * [1, -1 if scene.y_goes_down else 1]
    across = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
    for number, planners in enumerate(lanes):
        path = scene.paths[planners[0]]
        beside_in = across * (number - (len(lanes) - 1) / 2) * (width + 0.2) / 72
        moved = axes.transData + ScaledTranslation(beside_in[0], beside_in[1], inches)
        color, dashes = _look(number)
        look: dict[str, Any] = {
            "color": color,
            "linestyle": dashes,
            "linewidth": width,
            "transform": moved,
            "zorder": 3,
        }
        axes.plot(path[:, 0], path[:, 1], label=textwrap.fill(", ".join(planners), 20), **look)


def _look(index: int) -> tuple[str, str]:
    """Colours that colour-blind readers tell apart, then the same ones dashed."""
    return style.SERIES[index % len(style.SERIES)], "-" if index < len(style.SERIES) else "--"


def _draw_cells(axes: Axes, scene: PathScene) -> None:
    """Free cells white, growth grey, obstacles dark; large maps with fewer pixels."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    kinds = np.zeros(scene.occupied.shape, dtype=np.uint8)
    layers = ((scene.grown, "growth", GROWTH), (scene.occupied, "obstacle", OBSTACLE))
    for number, (mask, label, color) in enumerate(layers, start=1):
        if mask is not None and mask.any():
            kinds[mask] = number
            # Of no size: it only has its place in the legend.
            look: dict[str, Any] = {"facecolor": color, "edgecolor": style.GREY, "linewidth": 0.5}
            axes.add_patch(Rectangle((float(scene.start[0]), float(scene.start[1])), 0, 0, label=label, **look))
    step = max(1, math.ceil(math.sqrt(kinds.size / MAX_PIXELS)))
    coarse = _coarse(kinds, step)
    covered = (coarse.shape[0] * step, coarse.shape[1] * step)
    axes.imshow(
        coarse,
        origin="lower",
        extent=grid_extent_m(scene.origin, covered, scene.cell),
        cmap=ListedColormap(["white", GROWTH, OBSTACLE]),
        vmin=-0.5,
        vmax=2.5,
        zorder=style.ABOVE_GRID,
    )


def _coarse(kinds: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """The highest kind of step x step cells, so that no thin wall is lost."""
    if step == 1:
        return kinds
    rows, cols = (-(-size // step) for size in kinds.shape)
    padded = np.zeros((rows * step, cols * step), dtype=np.uint8)
    padded[: kinds.shape[0], : kinds.shape[1]] = kinds
    coarse: NDArray[np.uint8] = padded.reshape(rows, step, cols, step).max(axis=(1, 3))
    return coarse
