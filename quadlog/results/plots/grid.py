"""One instant as the planner saw it: the grid, the robot, the target, and the path between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float, Int
from quadlog.results.maps import MapSequence
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEADING_LENGTH_M = 0.6


def draw_grid(run: RunData) -> Figure | None:
    """The map with most occupied cells among a few of the middle ones that have a path, undilated as it is saved."""
    maps = run.maps
    if maps is None or not len(maps.t_ns):
        return None
    paths = run.table("paths")
    index = _instant(maps, paths)
    t_ns = int(maps.t_ns[index])
    left, bottom = (float(value) for value in maps.origin_m[index])
    rows, columns = maps.shape
    extent = (left, left + columns * maps.cell_m, bottom, bottom + rows * maps.cell_m)
    figure = style.new_figure(min(8.0, style.WIDTH_IN * rows / columns) + 0.2)
    axes = figure.subplots()
    axes.imshow(
        np.ma.masked_equal(maps.occupied(index), 0),
        origin="lower",
        extent=extent,
        cmap="Greys",
        vmin=0,
        vmax=1.3,
        zorder=style.ABOVE_GRID,
    )
    if paths is not None and np.any(paths["t_ns"] == t_ns):
        mine = paths["t_ns"] == t_ns
        axes.plot(paths["x_m"][mine], paths["y_m"][mine], ".", color=style.PLAN, markersize=4, label="path, cells")
        axes.plot(
            paths["smooth_x_m"][mine], paths["smooth_y_m"][mine], color=style.PLAN, linewidth=1.8, label="path, smooth"
        )
    _draw_mark(axes, run.table("target"), t_ns, "*", "target", style.TARGET)
    _draw_mark(axes, run.table("poses"), t_ns, "o", "robot and heading", style.ROBOT)
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x in map (m)", ylabel="y in map (m)", aspect="equal")
    seconds = float(run.seconds(maps.t_ns[index : index + 1])[0])
    axes.set_title(f"t = {seconds:.2f} s, {columns} × {rows} cells of {maps.cell_m:g} m", pad=22)
    style.legend_above(axes)
    return figure


def _instant(maps: MapSequence, paths: Table | None) -> int:
    """Index of a telling map: among nine from the middle half, with a path where possible, the fullest."""
    indices = np.arange(len(maps.t_ns))
    if paths is not None:
        with_path = indices[np.isin(maps.t_ns, paths["t_ns"])]
        indices = with_path if len(with_path) else indices
    middle = indices[len(indices) // 4 : max(len(indices) // 4 + 1, 3 * len(indices) // 4)]
    few = middle[style.thin_points(len(middle), 9)]
    return int(max(few, key=lambda index: int(maps.occupied(int(index)).sum())))


def _draw_mark(axes: Axes, table: Table | None, t_ns: int, marker: str, label: str, color: str) -> None:
    if table is None:
        return
    nearest = _nearest(table["t_ns"], t_ns)
    x_m, y_m = float(table["x_m"][nearest]), float(table["y_m"][nearest])
    size = 15 if marker == "*" else 9
    axes.plot(
        [x_m], [y_m], marker, color=color, markersize=size, markeredgecolor="white", label=label, linestyle="none"
    )
    if "yaw_rad" in table:
        direction: Float = HEADING_LENGTH_M * np.array(
            [np.cos(table["yaw_rad"][nearest]), np.sin(table["yaw_rad"][nearest])]
        )
        axes.plot([x_m, x_m + direction[0]], [y_m, y_m + direction[1]], color=color, linewidth=2.5)


def _nearest(known_ns: Int, t_ns: int) -> int:
    return int(np.argmin(np.abs(known_ns - t_ns)))
