"""UWB positions: errors over time with the claimed 95 % bound, and the geometry of the anchors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import layout as places
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table
from quadlog.results.run.maps import DilutionGrid
from quadlog.results.text.numbers import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_TAGS = 4
SHOWN_FIXES = 3000
BOUND_BINS = 200


def draw_uwb_error(run: RunData) -> Figure | None:
    """Per tag on the robot a panel of errors over time; only where the recording has a truth."""
    errors = run.table("uwb_errors")
    if errors is None:
        return None
    tags = np.unique(errors["tag"])
    shown = tags[:MAX_TAGS]
    figure, grid = style.new_stack(len(shown), 2.7, above_in=0.74)
    panels = grid[:, 0]
    for panel, tag in zip(panels, shown, strict=True):
        rows = {name: column[errors["tag"] == tag] for name, column in errors.items()}
        _draw_tag(run, panel, rows, f"tag {tag}" if len(tags) > 1 else "")
    note = f"   ({len(tags) - len(shown)} more tags not shown)" if len(tags) > len(shown) else ""
    panels[-1].set_xlabel(f"time (s){note}")
    return figure


def _draw_tag(run: RunData, panel: Axes, errors: Table, title: str) -> None:
    top_m = 0.1
    looks = {"fixes": (style.FIX, ".", SHOWN_FIXES), "track": (style.ROBOT, "-", 10000)}
    for source, (color, mark, limit) in looks.items():
        mine = {name: column[errors["source"] == source] for name, column in errors.items()}
        if not len(mine["t_ns"]):
            continue
        seconds, error_m = run.seconds(mine["t_ns"]), np.hypot(mine["error_x_m"], mine["error_y_m"])
        within = float(np.mean(error_m <= mine["bound_m"]))
        rmse_m = float(np.sqrt(np.mean(error_m**2)))
        keep = style.thin_points(len(seconds), limit) if mark == "." else style.thin_line(error_m, limit)
        label = f"{source}: RMSE {rmse_m:.3f} m, {percent(within)} within the bound"
        panel.plot(seconds[keep], error_m[keep], mark, color=color, label=label, markersize=2, linewidth=1.0)
        at, bound_m = _bound(seconds, mine["bound_m"])
        panel.plot(at, bound_m, color=color, linewidth=1.2, linestyle="--", label=f"{source}: 95 % bound claimed")
        top_m = max(top_m, float(np.percentile(error_m, 99.5)), float(np.max(bound_m)))
    panel.set_ylim(0, 1.15 * top_m)
    panel.set_ylabel("error (m)")
    if title:
        panel.set_title(title, pad=34)
    style.legend_above(panel, columns=2)


def _bound(seconds: Float, bound_m: Float) -> tuple[Float, Float]:
    """Median time and bound of equal segments; the bound changes with the direction of the error at each fix."""
    parts = np.array_split(np.arange(len(seconds)), min(BOUND_BINS, len(seconds)))
    middle_s, middle_m = (np.array([np.median(values[part]) for part in parts]) for values in (seconds, bound_m))
    return middle_s, middle_m


POOR_HDOP = 4.0
"""Upper limit of the grey scale."""
LEVELS = (0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.9, 1.0, 1.05, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
BAR_IN = 0.95  # the colour bar with its labels
SHOWN_DILUTION_FIXES, SHOWN_ELLIPSES, MAX_TAGS_NAMED = 2000, 24, 4
SCALE_95 = 2.447746830680816
"""Scale from the 1-sigma to the 95 % ellipse: square root of the chi-squared quantile for 2 dimensions, 5.991."""


def draw_uwb_geometry(run: RunData) -> Figure | None:
    """HDOP as background; anchors, fixes, some of their 95 % ellipses, the UWB tracks, and the reference."""
    grid, fixes = run.dilution, run.table("fixes")
    if grid is None or fixes is None:
        return None
    figure, axes = places.new_map(grid.extent_m, BAR_IN)
    _draw_dilution(axes, grid)
    solved = {name: column[np.isfinite(fixes["x_m"]) & ~fixes["outlier"]] for name, column in fixes.items()}
    if len(solved["x_m"]):
        _draw_fixes(axes, solved)
    for name, label, color in (("poses", "robot", style.ROBOT), ("target", "target", style.TARGET)):
        walk = run.table(name)
        if walk is not None and (walk["source"] == "uwb").any():
            keep = style.thin_points(len(walk["t_ns"]), 10000)
            axes.plot(walk["x_m"][keep], walk["y_m"][keep], color=color, linewidth=1.6, label=f"{label}, track")
    if (truth_m := run.reference_xy_m) is not None and run.table("uwb_errors") is not None:
        keep = style.thin_points(len(truth_m), 10000)
        axes.plot(truth_m[keep, 0], truth_m[keep, 1], "--", color=style.BLACK, linewidth=0.9, label="reference")
    _draw_ellipses(axes, solved)
    places.draw_anchors(axes, run.anchors(), "anchors", fontsize=10, fontweight="bold")
    places.add_head(figure, axes)
    return figure


def _draw_dilution(axes: Axes, grid: DilutionGrid) -> None:
    from matplotlib.patches import Rectangle

    best, poor = _limits(grid)
    hdop = np.nan_to_num(grid.hdop, nan=np.inf, posinf=np.inf).clip(max=2 * poor)
    image = axes.imshow(
        hdop,
        origin="lower",
        extent=grid.extent_m,
        cmap="Greys",
        vmin=best,
        vmax=best + 1.8 * (poor - best),  # darker greys would hide the lines
        zorder=style.ABOVE_GRID,
        interpolation="bilinear",
    )
    left, right, bottom, top = grid.extent_m
    # The panel may show more than the grid; white does not mean a low HDOP there.
    axes.add_patch(Rectangle((left, bottom), right - left, top - bottom, fill=False, edgecolor=style.GREY))
    levels = [level for level in LEVELS if best < level < poor]
    label = f"HDOP: std of a fix per std of a range (1), tag at {grid.tag_height_m:g} m"
    bar = places.add_bar(axes, image, label, boundaries=np.linspace(best, poor, 101), extend="max")
    bar.set_ticks(levels, labels=[f"{level:g}" for level in levels])
    if levels and min(hdop.shape) >= 2:
        half_m, (rows, columns) = grid.cell_m / 2, hdop.shape
        x_m = np.linspace(left + half_m, right - half_m, columns)
        y_m = np.linspace(bottom + half_m, top - half_m, rows)
        lines = axes.contour(x_m, y_m, hdop, levels, colors=style.GREY, linewidths=0.7, zorder=0.8)
        axes.clabel(lines, fontsize=8, fmt="%g", inline_spacing=2)


def _limits(grid: DilutionGrid) -> tuple[float, float]:
    """Limits of the grey scale: the best HDOP of the map, and one that most of the map is below."""
    known = grid.hdop[np.isfinite(grid.hdop)]
    if not len(known):
        return 0.0, POOR_HDOP
    best = float(known.min())
    return best, max(1.3 * best, min(float(np.percentile(known, 98)), POOR_HDOP))


def _draw_fixes(axes: Axes, fixes: Table) -> None:
    keep = style.thin_points(len(fixes["x_m"]), SHOWN_DILUTION_FIXES)
    tags = np.unique(fixes["tag"])
    label = f"fixes, {'tag' if len(tags) == 1 else 'tags'} {', '.join(str(tag) for tag in tags[:MAX_TAGS_NAMED])}"
    label += ", …" * (len(tags) > MAX_TAGS_NAMED)
    axes.plot(fixes["x_m"][keep], fixes["y_m"][keep], ".", color=style.FIX, markersize=2.5, alpha=0.6, label=label)


def _draw_ellipses(axes: Axes, fixes: Table) -> None:
    """Outlines of some fixes' 95 % ellipses, chosen evenly over all fixes, which lie in order of tag and time."""
    label: str | None = "95 % ellipses of some"
    turn = np.linspace(0, 2 * np.pi, 61)
    circle = SCALE_95 * np.stack([np.cos(turn), np.sin(turn)])
    for index in style.thin_points(len(fixes["x_m"]), SHOWN_ELLIPSES):
        outline = _root(fixes, index) @ circle + np.array([[fixes["x_m"][index]], [fixes["y_m"][index]]])
        axes.plot(outline[0], outline[1], color=style.NOTE, linewidth=1.1, label=label)
        label = None


def _root(fixes: Table, index: Any) -> Float:
    """L (2, 2) with L L^T the fix's covariance: it turns a unit circle into the standard ellipse."""
    xx, xy, yy = (float(fixes[name][index]) for name in ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2"))
    std_x = max(xx, 1e-12) ** 0.5
    return np.array([[std_x, 0.0], [xy / std_x, max(yy - xy * xy / std_x**2, 0.0) ** 0.5]])
