"""Paths of several planners over the map they were planned on [Planning, Figs 15-17, 19-21]."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.comparison import legend_entries, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OBSTACLE, GROWTH, SEARCHED = "#3a3a3a", "#c4c4c4", "#fbe6ae"
MAX_PIXELS = 4_000_000
LEAST_MARGIN_CELLS = 10


@dataclass(frozen=True, slots=True)
class PathScene:
    """One map and what was planned on it.

    occupied: (rows, cols) bool, row = y; grown: the same with the obstacles' growth, or None without any.
    paths: (L, 2) x, y per planner, in the order of drawing; empty where there is none.
    start, goal: (2,); cell: edge of a cell; origin: (2,) lower-left corner of the map; all in `unit`.
    searched: (rows, cols) bool, the cells that searched_by expanded, or None.
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
    searched: NDArray[np.bool_] | None = None
    searched_by: str = ""
    y_goes_down: bool = False

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top, as imshow takes them."""
        (left, bottom), (rows, cols) = self.origin, self.occupied.shape
        return left, left + cols * self.cell, bottom, bottom + rows * self.cell


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
        searched=None if scene.searched is None else scene.searched[part],
        origin=(origin_x + left * scene.cell, origin_y + bottom * scene.cell),
    )


def draw_paths(scenes: Sequence[PathScene]) -> Figure | None:
    """A panel per scene; a planner has the same colour in all, and planners whose paths are all the same share a line.

    Lines on the same cells are drawn beside one another, across the way from start to goal.
    """
    if not scenes:
        return None
    columns = {1: 1, 2: 2, 4: 2}.get(len(scenes), 3)
    rows = math.ceil(len(scenes) / columns)
    lanes = same_paths(scenes)
    panel_in = 5.2 if columns == 1 else (style.WIDTH_IN - 0.7 * columns) / columns
    tallest = max(scene.occupied.shape[0] / scene.occupied.shape[1] for scene in scenes)
    legend_in = 0.0 if columns == 1 else 0.22 * math.ceil((len(lanes) + 5) / 4) + 0.1
    figure = style.new_figure(rows * (panel_in * min(max(tallest, 0.3), 2.0) + 0.65) + legend_in)
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for panel, scene in zip(panels, scenes, strict=False):
        _draw_scene(panel, scene, lanes)
    for panel in panels[len(scenes) :]:
        panel.remove()
    entries = legend_entries(panels[: len(scenes)])
    if columns == 1:
        beside = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0)}
        panels[0].legend(entries.values(), entries.keys(), borderaxespad=0, labelspacing=0.8, **beside)
    else:
        figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=4)
    return figure


def same_paths(scenes: Sequence[PathScene]) -> list[list[str]]:
    """The planners in order of their first path, those together whose paths are the same in every scene."""
    groups: list[list[str]] = []
    for name in dict.fromkeys(name for scene in scenes for name, path in scene.paths.items() if len(path)):
        alike = (group for group in groups if all(_is_same(scene.paths, name, group[0]) for scene in scenes))
        group = next(alike, None)
        if group is None:
            groups.append([name])
        else:
            group.append(name)
    return groups


def _is_same(paths: Mapping[str, Float], first: str, second: str) -> bool:
    nothing = np.empty((0, 2))
    return np.array_equal(paths.get(first, nothing), paths.get(second, nothing))


def _draw_scene(axes: Axes, scene: PathScene, lanes: Sequence[Sequence[str]]) -> None:
    from matplotlib.transforms import ScaledTranslation

    _draw_cells(axes, scene)
    figure = axes.get_figure(root=True)
    assert figure is not None
    width = 2.0 if len(lanes) <= 4 else 1.4
    along = (np.asarray(scene.goal, np.float64) - scene.start) * [1, -1 if scene.y_goes_down else 1]
    across = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
    for number, planners in enumerate(lanes):
        path = scene.paths.get(planners[0], np.empty((0, 2)))
        if not len(path):
            continue
        beside_in = across * (number - (len(lanes) - 1) / 2) * (width + 0.2) / 72
        moved = axes.transData + ScaledTranslation(beside_in[0], beside_in[1], figure.dpi_scale_trans)
        color, dashes = _look(number)
        look: dict[str, Any] = {
            "color": color,
            "linestyle": dashes,
            "linewidth": width,
            "transform": moved,
            "zorder": 3,
        }
        axes.plot(path[:, 0], path[:, 1], label=textwrap.fill(", ".join(planners), 20), **look)
    mark: dict[str, Any] = {"color": style.BLACK, "markeredgecolor": "white", "linestyle": "none", "zorder": 4}
    axes.plot(*scene.start, "o", markersize=9, label="start", **mark)
    axes.plot(*scene.goal, "*", markersize=15, label="goal", **mark)
    left, right, bottom, top = scene.extent
    axes.set(xlim=(left, right), ylim=(top, bottom) if scene.y_goes_down else (bottom, top), aspect="equal")
    axes.set(xlabel=f"x ({scene.unit})", ylabel=f"y ({scene.unit})")
    axes.set_title(plain(scene.title))
    axes.grid(visible=False)


def _look(index: int) -> tuple[str, str]:
    """Colours that colour-blind readers tell apart, then the same ones dashed."""
    return style.SERIES[index % len(style.SERIES)], "-" if index < len(style.SERIES) else "--"


def _draw_cells(axes: Axes, scene: PathScene) -> None:
    """Free cells white, searched ones pale, growth grey, obstacles dark; large maps with fewer pixels."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    kinds = np.zeros(scene.occupied.shape, dtype=np.uint8)
    layers = (
        (scene.searched, f"expanded by {scene.searched_by}"),
        (scene.grown, "growth"),
        (scene.occupied, "obstacle"),
    )
    colors = (SEARCHED, GROWTH, OBSTACLE)
    for number, ((mask, label), color) in enumerate(zip(layers, colors, strict=True), start=1):
        if mask is not None and mask.any():
            kinds[mask] = number
            # Of no size: it only has its place in the legend.
            look: dict[str, Any] = {"facecolor": color, "edgecolor": style.GREY, "linewidth": 0.5}
            axes.add_patch(Rectangle((float(scene.start[0]), float(scene.start[1])), 0, 0, label=label, **look))
    step = max(1, math.ceil(math.sqrt(kinds.size / MAX_PIXELS)))
    axes.imshow(
        _coarse(kinds, step),
        origin="lower",
        extent=_coarse_extent(scene, step),
        cmap=ListedColormap(["white", SEARCHED, GROWTH, OBSTACLE]),
        vmin=-0.5,
        vmax=3.5,
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


def _coarse_extent(scene: PathScene, step: int) -> tuple[float, float, float, float]:
    left, _, bottom, _ = scene.extent
    rows, cols = (-(-size // step) * step for size in scene.occupied.shape)
    return left, left + cols * scene.cell, bottom, bottom + rows * scene.cell
