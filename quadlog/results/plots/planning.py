"""The grid at one replan, and the cells searched per replan [Planning, Fig. 18]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import layout as places
from quadlog.results.plots import style
from quadlog.results.plots.layout import Pose, draw_body
from quadlog.results.plots.run_data import RunData, Table
from quadlog.results.run.maps import MapSequence, grid_extent_m
from quadlog.results.text.numbers import count

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
    style.ring(panel, seconds[scratch], plans["expanded"][scratch])
    if failed.any():
        style.mark_on_axis(panel, seconds[failed], "no path found", 6)
    panel.set_ylim(bottom=0)
    panel.set_ylabel("cells per replan (count)")
    planners = ", ".join(sorted({str(planner) for planner in plans["planner"]}))
    panel.set_title(
        f"{name}, {planners}: {count(len(seconds))} replans, "
        f"{count(int(plans['expanded'].sum()))} cells expanded, "
        f"{count(int(scratch.sum()))} from scratch",
        pad=22,
    )
    style.legend_above(panel)


LEAST_REACH_M, ROUND_M = 2.0, 0.7
"""Half size of the close view, at least; margin around what it must show."""
MARGIN = 0.02
HIGH_PER_WIDE = (0.6, 2.0)
"""Limits of the panel's aspect ratio; a longer window does not fill it."""
_BETWEEN_IN = 0.95


def draw_grid(run: RunData) -> Figure | None:
    """The whole window, and beside it what lies around robot, path and target; undilated, as it is saved.

    The map is the one with most occupied cells among a few of the middle ones that have a path.
    """
    maps = run.maps
    if maps is None or not len(maps.t_ns):
        return None
    index = _instant(maps, run.table("paths"))
    t_ns = int(maps.t_ns[index])
    path, target, robot = _path_at(run, t_ns), _row_at(run.table("target"), t_ns), _row_at(run.table("poses"), t_ns)
    high_per_wide = float(np.clip(maps.shape[0] / maps.shape[1], *HIGH_PER_WIDE))
    figure, (whole, close) = _new_views(high_per_wide)
    for axes in (whole, close):
        _draw_cells(axes, maps, index)
        if path is not None:
            axes.plot(
                path["x_m"], path["y_m"], ".-", color=style.NOTE, markersize=4, linewidth=0.8, label="path, cells"
            )
            axes.plot(path["smooth_x_m"], path["smooth_y_m"], color=style.PLAN, linewidth=2.0, label="path, smooth")
        if target is not None:
            size: dict[str, Any] = {"markersize": 14, "markeredgecolor": "white", "linestyle": "none"}
            axes.plot(*target[:2], "*", color=style.TARGET, label="target", **size)
        if robot is not None:
            draw_body(axes, robot, run.body_m(), dot=6.0 if axes is whole else 0.0)
    _frame_whole(whole, _extent(maps, index), high_per_wide)
    _frame_close(whole, close, _extent(maps, index), _points_to_show(path, target, robot))
    seconds = float(run.seconds(maps.t_ns[index : index + 1])[0])
    rows, columns = maps.shape
    occupied = count(int(maps.occupied(index).sum()))
    whole.set_title("the whole window")
    close.set_title("around robot and path")
    title = f"t = {seconds:.2f} s, {columns} × {rows} cells of {maps.cell_m:g} m, {occupied} of them occupied"
    places.add_head(figure, whole, title)
    return figure


def _new_views(high_per_wide: float) -> tuple[Figure, list[Axes]]:
    """A figure with a panel of this shape and, as high as that, a square one beside it."""
    free_in = style.WIDTH_IN - style.LEFT_IN - _BETWEEN_IN - places.EDGE_IN
    high_in = free_in / (1 + 1 / high_per_wide)
    left_in, right_in, top_in = style.LEFT_IN, style.WIDTH_IN - places.EDGE_IN, style.BELOW_IN + high_in
    return places.new_panels(
        (left_in, right_in - high_in - _BETWEEN_IN, style.BELOW_IN, top_in),
        (right_in - high_in, right_in, style.BELOW_IN, top_in),
    )


def _instant(maps: MapSequence, paths: Table | None) -> int:
    """Index of the map to draw: the fullest of nine from the middle half, with a path where possible."""
    indices = np.arange(len(maps.t_ns))
    if paths is not None:
        with_path = indices[np.isin(maps.t_ns, paths["t_ns"])]
        indices = with_path if len(with_path) else indices
    middle = indices[len(indices) // 4 : max(len(indices) // 4 + 1, 3 * len(indices) // 4)]
    few = middle[style.thin_points(len(middle), 9)]
    return int(max(few, key=lambda index: int(maps.occupied(int(index)).sum())))


def _path_at(run: RunData, t_ns: int) -> Table | None:
    paths = run.table("paths")
    if paths is None or not np.any(paths["t_ns"] == t_ns):
        return None
    return {name: column[paths["t_ns"] == t_ns] for name, column in paths.items()}


def _row_at(table: Table | None, t_ns: int) -> Pose | None:
    """x, y and, where the table has one, yaw of the nearest row; None where there is no place."""
    if table is None:
        return None
    nearest = int(np.argmin(np.abs(table["t_ns"] - t_ns)))
    x_m, y_m = float(table["x_m"][nearest]), float(table["y_m"][nearest])
    yaw_rad = float(table["yaw_rad"][nearest]) if "yaw_rad" in table else np.nan
    return (x_m, y_m, yaw_rad) if np.isfinite([x_m, y_m]).all() else None


def _extent(maps: MapSequence, index: int) -> places.Extent:
    return grid_extent_m(maps.origin_m[index], maps.shape, maps.cell_m)


def _draw_cells(axes: Axes, maps: MapSequence, index: int) -> None:
    axes.imshow(
        np.ma.masked_equal(maps.occupied(index), 0),
        origin="lower",
        extent=_extent(maps, index),
        cmap="Greys",
        vmin=0,
        vmax=1.3,
        zorder=style.ABOVE_GRID,
    )


def _points_to_show(path: Table | None, target: Pose | None, robot: Pose | None) -> Float:
    """(N, 2) what the close view must hold."""
    points = [np.array([pose[:2]]) for pose in (target, robot) if pose is not None]
    if path is not None:
        points.append(np.column_stack([path["x_m"], path["y_m"]]))
    return np.concatenate([np.empty((0, 2)), *points])


def _frame_whole(whole: Axes, extent: places.Extent, high_per_wide: float) -> None:
    """Limits with some margin, so that the window's edge is seen."""
    left, right, bottom, top = extent
    margin_m = MARGIN * max(right - left, top - bottom)
    places.show_all(whole, (left - margin_m, right + margin_m, bottom - margin_m, top + margin_m), high_per_wide)


def _frame_close(whole: Axes, close: Axes, extent: places.Extent, points_m: Float) -> None:
    """What the right shows, marked on the left: a square, inside the window where it fits; and the window's edge."""
    from matplotlib.patches import Rectangle

    left, right, bottom, top = extent
    for axes in (whole, close):
        edge = Rectangle((left, bottom), right - left, top - bottom, fill=False, linewidth=1.2, label="window")
        axes.add_patch(edge)
    shown = points_m[(points_m >= (left, bottom)).all(axis=1) & (points_m <= (right, top)).all(axis=1)]
    if not len(shown):
        shown = np.array([[(left + right) / 2, (bottom + top) / 2]])
    middle = (shown.min(axis=0) + shown.max(axis=0)) / 2
    reach_m = max(LEAST_REACH_M, float(np.ptp(shown, axis=0).max()) / 2 + ROUND_M)
    low, high = middle - reach_m, middle + reach_m
    places.show_all(close, (low[0], high[0], low[1], high[1]), 1.0)
    whole.add_patch(Rectangle(low, *(high - low), fill=False, edgecolor=style.GREY, linestyle=":", linewidth=1.2))
