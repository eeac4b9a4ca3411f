"""Everything that moves, over everything that stands: the picture to look at first."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.occupancy import seen_around
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARGIN_M = 2.0
SHOWN_PLANS = 12


def draw_trajectory(run: RunData) -> Figure | None:
    """Robot, target, fixes, some plans and the re-simulated walk over the accumulated map, in metres of `map`."""
    walks = {name: run.table(name) for name in ("poses", "target", "control")}
    paths = [_xy(table) for table in walks.values() if table is not None]
    fixes = run.table("fixes")
    if not paths and fixes is None:
        return None
    anchors = run.anchors()
    # Fixes scatter; they decide what the picture shows only where there is no path.
    walked = paths or [_xy(fixes or {})]
    seen_m = seen_around(np.concatenate(walked), run.occupancy)
    low_m, high_m = _view([*walked, seen_m], [anchor[1:] for anchor in anchors])
    width_m, height_m = high_m - low_m
    across_in = style.WIDTH_IN * (0.79 if run.maps is not None else 0.87)  # the rest is the colour bar and the labels
    figure = style.new_figure(float(across_in * height_m / width_m) + 1.3)
    axes = figure.subplots()
    _draw_map(run, figure, axes)
    # A follower walks where its target walked: the later line is thinner, so that the earlier shows beside it.
    _draw_walk(axes, walks["poses"], "robot", style.ROBOT, 3.6)
    _draw_walk(axes, walks["target"], "target", style.TARGET, 1.4)
    # A simulated robot is on its course, within a line's width: the course is drawn broad, and below it.
    label = "simulated walk" if run.simulated else "re-simulated walk"
    if run.simulated:
        _draw_walk(axes, run.table("paths"), "course", style.LIGHT, 5.0)
    _draw_walk(axes, walks["control"], label, style.RESIM, 1.8)
    if not run.simulated:
        _draw_plans(axes, run.table("paths"))
    # Only where it was compared: a truth in another frame would be somewhere else.
    if run.metric("ate_rmse_m") is not None and (truth_m := run.reference_xy_m) is not None:
        keep = style.thin_points(len(truth_m), 10000)
        axes.plot(truth_m[keep, 0], truth_m[keep, 1], "--", color=style.BLACK, linewidth=0.9, label="reference")
    if fixes is not None:
        _draw_fixes(axes, fixes)
    _draw_anchors(axes, anchors, low_m, high_m)
    axes.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[1], high_m[1]), xlabel="x in map (m)", ylabel="y in map (m)")
    axes.set_aspect("equal")
    style.legend_above(axes, columns=4)
    return figure


def _xy(table: Table) -> Float:
    xy = np.column_stack([table["x_m"], table["y_m"]])
    return xy[np.isfinite(xy).all(axis=1)]


def _view(paths: list[Float], anchors_m: list[tuple[float, float]]) -> tuple[Float, Float]:
    """Lower-left and upper-right corner (2,) of what is shown: all paths, and anchors unless far away."""
    points = np.concatenate([*paths, np.zeros((0, 2))])
    if not len(points):
        points = np.zeros((1, 2))
    low_m, high_m = points.min(axis=0), points.max(axis=0)
    reach_m = 10.0 + (high_m - low_m).max()
    for anchor in np.array(anchors_m).reshape(-1, 2):
        if np.all(anchor > low_m - reach_m) and np.all(anchor < high_m + reach_m):
            points = np.concatenate([points, anchor[None]])
    low_m, high_m = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    # Never narrower than 1 : 2.5, else the figure would be a thread.
    size_m, middle_m = high_m - low_m, (high_m + low_m) / 2
    size_m = np.maximum(size_m, size_m.max() / 2.5)
    return middle_m - size_m / 2, middle_m + size_m / 2


def _draw_map(run: RunData, figure: Figure, axes: Axes) -> None:
    occupancy = run.occupancy
    if occupancy is None:
        return
    share = np.ma.masked_invalid(np.where(occupancy.share > 0, occupancy.share, np.nan))
    image = axes.imshow(
        share, origin="lower", extent=occupancy.extent_m, cmap="Greys", vmin=-0.15, vmax=1, zorder=style.ABOVE_GRID
    )
    bar = figure.colorbar(image, ax=axes, shrink=0.5, pad=0.01, aspect=25, boundaries=np.linspace(0, 1, 101))
    bar.set_label("share of maps with the cell occupied (1)", fontsize=9)
    bar.set_ticks([0, 0.5, 1])


def _draw_fixes(axes: Axes, fixes: Table) -> None:
    good = _xy({name: fixes[name][~fixes["outlier"].astype(bool)] for name in ("x_m", "y_m")})
    keep = style.thin_points(len(good), 4000)
    axes.plot(
        good[keep, 0], good[keep, 1], ".", color=style.FIX, markersize=2, alpha=0.45, zorder=1.5, label="UWB fixes"
    )


def _draw_plans(axes: Axes, paths: Table | None) -> None:
    if paths is None:
        return
    instants = np.unique(paths["t_ns"])
    label: str | None = "some plans"
    for t_ns in instants[style.thin_points(len(instants), SHOWN_PLANS)]:
        mine = paths["t_ns"] == t_ns
        x, y = paths["smooth_x_m"][mine], paths["smooth_y_m"][mine]
        if not np.isfinite(x).any():
            x, y = paths["x_m"][mine], paths["y_m"][mine]
        axes.plot(x, y, color=style.PLAN, linewidth=1.0, alpha=0.9, label=label)
        label = None


def _draw_walk(axes: Axes, table: Table | None, label: str, color: str, width: float) -> None:
    if table is None:
        return
    xy = _xy(table)
    if not len(xy):
        return
    keep = style.thin_points(len(xy), 10000)
    axes.plot(xy[keep, 0], xy[keep, 1], color=color, linewidth=width, label=label)
    axes.plot(*xy[0], "o", color=color, markersize=7, markeredgecolor="white", markeredgewidth=1.0)
    axes.plot(*xy[-1], "s", color=color, markersize=7, markeredgecolor="white", markeredgewidth=1.0)


def _draw_anchors(axes: Axes, anchors: list[tuple[int, float, float]], low_m: Float, high_m: Float) -> None:
    seen = [a for a in anchors if low_m[0] <= a[1] <= high_m[0] and low_m[1] <= a[2] <= high_m[1]]
    if not seen:
        return
    left_out = len(anchors) - len(seen)
    label = "UWB anchors" + (f" ({left_out} outside)" if left_out else "")
    axes.plot(
        [a[1] for a in seen], [a[2] for a in seen], "^", color=style.BLACK, markersize=8, linestyle="none", label=label
    )
    for anchor, x_m, y_m in seen:
        axes.annotate(f"{anchor}", (x_m, y_m), xytext=(6, 4), textcoords="offset points", fontsize=9)
