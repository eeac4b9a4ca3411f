"""Trajectories over the map, and the height map of the ground."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import layout as places
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table, seen_around
from quadlog.results.run.maps import grid_extent_m
from quadlog.results.text.numbers import count

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAR_IN = 1.2  # the colour bar with its labels, down to −99.999 m


def draw_terrain(run: RunData) -> Figure | None:
    """Mean height of ground points per cell, in metres of `map`; cells without ground points stay empty."""
    from matplotlib.ticker import MaxNLocator

    ground = run.ground
    if ground is None:
        return None
    height_m, cell_m = ground.height_m, float(ground.cell_m)
    known_row, known_column = np.nonzero(np.isfinite(height_m))
    if not len(known_row):
        return None
    rows = slice(int(known_row.min()), int(known_row.max()) + 1)
    columns = slice(int(known_column.min()), int(known_column.max()) + 1)
    cut = height_m[rows, columns]
    corner_m = ground.origin_m + cell_m * np.array([columns.start, rows.start])
    extent = grid_extent_m(corner_m, cut.shape, cell_m)
    low_m, high_m = np.percentile(cut[np.isfinite(cut)], [1, 99])
    figure, axes = places.new_map(extent, BAR_IN, places.TITLE_IN)
    # At least 2 cm of range: sensor noise on a flat floor should look flat.
    image = axes.imshow(
        np.ma.masked_invalid(cut),
        origin="lower",
        extent=extent,
        cmap="cividis",
        zorder=style.ABOVE_GRID,
        vmin=float(low_m),
        vmax=float(max(high_m, low_m + 0.02)),
    )
    axes.set_title(f"{count(len(known_row))} cells of {cell_m:g} m; 98 % of heights within {high_m - low_m:.3f} m")
    few = MaxNLocator(6, steps=[1, 2, 5, 10])  # such ticks have short labels
    places.add_bar(axes, image, "height of the ground (m)", extend="both", ticks=few)
    return figure


MARGIN_M = 2.0
SHOWN_PLANS = 12
COLOUR_BAR_IN = 0.85  # the colour bar with its labels


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
    extent_m = _view([*walked, seen_m], [anchor[1:] for anchor in anchors])
    figure, axes = places.new_map(extent_m, COLOUR_BAR_IN if run.occupancy is not None else places.EDGE_IN)
    _draw_map(run, axes)
    # A follower walks where its target walked: the later line is thinner, so that the earlier shows beside it.
    _draw_walk(axes, walks["poses"], "robot", style.ROBOT, 3.6)
    _draw_errors(axes, run)
    if not is_ahead(walks["target"]):
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
    _draw_anchors(axes, anchors)
    places.add_head(figure, axes)
    return figure


def _xy(table: Table) -> Float:
    xy = np.column_stack([table["x_m"], table["y_m"]])
    return xy[np.isfinite(xy).all(axis=1)]


def _view(paths: list[Float], anchors_m: list[tuple[float, float]]) -> places.Extent:
    """What is to be seen: all paths, and anchors unless far away."""
    points = np.concatenate([*paths, np.zeros((0, 2))])
    if not len(points):
        points = np.zeros((1, 2))
    low_m, high_m = points.min(axis=0), points.max(axis=0)
    reach_m = 10.0 + (high_m - low_m).max()
    for anchor in np.array(anchors_m).reshape(-1, 2):
        if np.all(anchor > low_m - reach_m) and np.all(anchor < high_m + reach_m):
            points = np.concatenate([points, anchor[None]])
    (left_m, bottom_m), (right_m, top_m) = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    return float(left_m), float(right_m), float(bottom_m), float(top_m)


def _draw_map(run: RunData, axes: Axes) -> None:
    occupancy = run.occupancy
    if occupancy is None:
        return
    share = np.ma.masked_invalid(np.where(occupancy.share > 0, occupancy.share, np.nan))
    image = axes.imshow(
        share, origin="lower", extent=occupancy.extent_m, cmap="Greys", vmin=-0.15, vmax=1, zorder=style.ABOVE_GRID
    )
    label = "share of maps with the cell occupied (1)"
    places.add_bar(axes, image, label, boundaries=np.linspace(0, 1, 101), ticks=[0, 0.5, 1])


def _draw_fixes(axes: Axes, fixes: Table) -> None:
    good = _xy({name: fixes[name][~fixes["outlier"].astype(bool)] for name in ("x_m", "y_m")})
    keep = style.thin_points(len(good), 4000)
    axes.plot(
        good[keep, 0], good[keep, 1], ".", color=style.FIX, markersize=2, alpha=0.45, zorder=1.5, label="UWB fixes"
    )


def _draw_plans(axes: Axes, paths: Table | None) -> None:
    label: str | None = "some plans"
    for x, y in some_plans(paths):
        axes.plot(x, y, color=style.PLAN, linewidth=1.0, alpha=0.9, label=label)
        label = None


def some_plans(paths: Table | None) -> Iterator[tuple[Float, Float]]:
    """Yields x and y of SHOWN_PLANS plans, evenly over the run: the smooth curve, or the path where there is none."""
    if paths is None:
        return
    instants = np.unique(paths["t_ns"])
    for t_ns in instants[style.thin_points(len(instants), SHOWN_PLANS)]:
        mine = paths["t_ns"] == t_ns
        x, y = paths["smooth_x_m"][mine], paths["smooth_y_m"][mine]
        yield (x, y) if np.isfinite(x).any() else (paths["x_m"][mine], paths["y_m"][mine])


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


def _draw_errors(axes: Axes, run: RunData) -> None:
    """The robot's line again, in the colours of its error, where there is a reference."""
    poses, error_m = run.table("poses"), run.pose_error_m
    if poses is None or error_m is None or not np.isfinite(error_m).any():
        return
    keep = style.thin_points(len(error_m), 10000)
    of, labels = style.error_classes(error_m[keep])
    x_m, y_m = poses["x_m"][keep], poses["y_m"][keep]
    for index, (color, label) in enumerate(zip(style.ERROR_COLORS, labels, strict=True)):
        if not (of == index).any():
            continue
        mine = of == index
        mine[1:] |= mine[:-1]  # to the next point, so that the line has no gaps
        axes.plot(np.where(mine, x_m, np.nan), np.where(mine, y_m, np.nan), color=color, linewidth=3.6, label=label)


def describe_trajectory(run: RunData, is_chart: bool) -> str:
    """What this run's map, or its chart, shows: a caption of what is there alone."""
    names = [("poses", "the robot"), ("control", "the re-simulated walk")]
    if not is_ahead(run.table("target")):
        names.insert(1, ("target", "its target"))
    if run.simulated:
        names = [("paths", "the course"), ("control", "the simulated walk")]
    text = f"{join_words([label for name, label in names if run.table(name) is not None])} from above"
    text = f"{text[:1].upper()}{text[1:]} (● start, ■ end)"
    beside = [("fixes", "UWB fixes (dots)"), *([] if run.simulated else [("paths", "some of the plans")])]
    others = [label for name, label in beside if run.table(name) is not None]
    truth = run.metric("ate_rmse_m") is not None and run.reference_xy_m is not None
    others += ["the reference (dashed)"] * truth
    text += f", with {join_words(others)}." if others else "."
    if truth and run.pose_error_m is not None:
        text += " The robot's line has the colour of its distance to the reference at that instant."
    if run.occupancy is not None:
        text += (
            " Grey: cells that were occupied in at least half of the maps that covered them."
            if is_chart
            else " The darker a cell, the more of the maps that covered it had it occupied: walls are dark, what "
            "moved is pale."
        )
    return text


def is_ahead(target: Table | None) -> bool:
    """Whether what is followed is the robot's own future, which lies on the robot's line."""
    return target is not None and set(target["source"]) == {"ahead"}


def join_words(words: list[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _draw_anchors(axes: Axes, anchors: list[tuple[int, float, float]]) -> None:
    (left_m, right_m), (bottom_m, top_m) = axes.get_xlim(), axes.get_ylim()
    seen = [a for a in anchors if left_m <= a[1] <= right_m and bottom_m <= a[2] <= top_m]
    if not seen:
        return
    left_out = len(anchors) - len(seen)
    label = "UWB anchors" + (f" ({left_out} outside)" if left_out else "")
    places.draw_anchors(axes, seen, label, fontsize=9)
