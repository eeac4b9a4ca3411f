"""Panels and maps of figures, and the robot drawn to scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.results.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Pose = tuple[float, float, float]
_NOSE = 1.0  # how far the line that shows the heading sticks out, in half lengths of the body


def draw_body(axes: Axes, pose: Pose, size_m: tuple[float, float] | None, dot: float = 0.0) -> None:
    """The body at a pose (x_m, y_m, yaw_rad), length by width; a triangle if the size is unknown.

    dot: size in points of a dot on it, for pictures in which the footprint is too small to be seen.
    """
    x_m, y_m, yaw_rad = pose
    if size_m is None or not np.isfinite(yaw_rad):
        heading_deg = np.degrees(yaw_rad) if np.isfinite(yaw_rad) else 90.0
        marker = (3, 0, heading_deg - 90)
        axes.plot([x_m], [y_m], marker=marker, color=style.ROBOT, markersize=11, linestyle="none", label="robot")
        return
    half = np.array(size_m) / 2
    nose = [(1, 0), (1 + _NOSE, 0), (1, 0)]
    corners = np.array([*nose, (1, 1), (-1, 1), (-1, -1), (1, -1), (1, 0)]) * half
    turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
    outline = corners @ turn.T + (x_m, y_m)
    axes.fill(outline[2:, 0], outline[2:, 1], color=style.ROBOT, alpha=0.25, linewidth=0)
    axes.plot(outline[:, 0], outline[:, 1], color=style.ROBOT, linewidth=1.8, label="robot and heading")
    if dot:
        axes.plot([x_m], [y_m], "o", color=style.ROBOT, markersize=dot, markeredgecolor="white")


def draw_anchors(axes: Axes, anchors: Sequence[tuple[int, float, float]], label: str, **text: Any) -> None:
    """Anchors (id, x_m, y_m) as triangles with their numbers. text: as `Axes.annotate` takes it."""
    x_m, y_m = [anchor[1] for anchor in anchors], [anchor[2] for anchor in anchors]
    axes.plot(x_m, y_m, "^", color=style.BLACK, markersize=8, linestyle="none", label=label)
    for anchor, x, y in anchors:
        axes.annotate(f"{anchor}", (x, y), xytext=(6, 4), textcoords="offset points", **text)


Extent = tuple[float, float, float, float]
"""Left, right, bottom, top."""

OVER_IN, TITLE_IN = 0.14, 0.3
"""Free over a panel, without and with a title; a large number that all ticks share is written there."""
EDGE_IN = 0.25
"""Free on the right of a panel, where half of a tick label may stick out."""

# Heights of a map: with what is above and below it, the least holds a colour bar's label, the greatest fits a page.
_LEAST_IN, _MOST_IN = 3.0, 10.4
_HEADING_IN = 0.35
_BAR_IN, _BAR_GAP_IN, _BAR_LABEL_IN, _BAR_SHARE = 0.13, 0.1, 0.24, 0.6


def new_panels(*places_in: Extent, over_in: float = TITLE_IN) -> tuple[Figure, list[Axes]]:
    """A figure and a panel in each place: left, right, bottom, top. The figure ends over_in above the highest.

    `add_head` makes it higher.
    """
    height_in = max(top for *_, top in places_in) + over_in
    figure = style.new_figure(height_in, layout=None)
    panels = []
    for left, right, bottom, top in places_in:
        wide, high = (right - left) / style.WIDTH_IN, (top - bottom) / height_in
        panels.append(figure.add_axes((left / style.WIDTH_IN, bottom / height_in, wide, high)))
        style.fix_labels(panels[-1], right - left, top - bottom)
    return figure, panels


def new_map(extent_m: Extent, right_in: float = EDGE_IN, over_in: float = OVER_IN) -> tuple[Figure, Axes]:
    """A figure and its panel of all of extent_m, as wide as leaves right_in free on its right: for `add_bar`, say.

    It shows more than extent_m where it would be too flat for a colour bar or too high for a page.
    """
    left_m, right_m, bottom_m, top_m = extent_m
    wide_in = style.WIDTH_IN - style.LEFT_IN - right_in
    high_in = float(np.clip(wide_in * (top_m - bottom_m) / (right_m - left_m), _LEAST_IN, _MOST_IN))
    place_in = (style.LEFT_IN, style.LEFT_IN + wide_in, style.BELOW_IN, style.BELOW_IN + high_in)
    figure, (panel,) = new_panels(place_in, over_in=over_in)
    show_all(panel, extent_m, high_in / wide_in)
    return figure, panel


def show_all(panel: Axes, extent_m: Extent, high_per_wide: float) -> None:
    """Limits of a map whose panel has this shape: extent_m in the middle, x and y to the same scale."""
    left_m, right_m, bottom_m, top_m = extent_m
    half_m = max(right_m - left_m, (top_m - bottom_m) / high_per_wide) / 2
    x_m, y_m, half_y_m = (left_m + right_m) / 2, (bottom_m + top_m) / 2, half_m * high_per_wide
    panel.set(xlim=(x_m - half_m, x_m + half_m), ylim=(y_m - half_y_m, y_m + half_y_m), aspect="equal")
    panel.set(xlabel="x in map (m)", ylabel="y in map (m)")


def add_bar(panel: Axes, image: Any, label: str, **how: Any) -> Colorbar:
    """A colour bar beside a panel, and its label at the figure's right edge. how: as `Figure.colorbar` takes it."""
    figure: Any = panel.figure
    wide_in, place = float(figure.get_figwidth()), panel.get_position(original=True)
    bottom = place.y0 + place.height * (1 - _BAR_SHARE) / 2
    left_in = place.x1 * wide_in + _BAR_GAP_IN
    axes = figure.add_axes((left_in / wide_in, bottom, _BAR_IN / wide_in, place.height * _BAR_SHARE))
    axes.grid(visible=False)
    bar: Colorbar = figure.colorbar(image, cax=axes, **how)
    bar.set_label(label, fontsize=9)
    # A large number that all ticks share would be written leftwards, over the map.
    axes.yaxis.get_offset_text().set_horizontalalignment("left")
    axes.yaxis.set_label_coords((wide_in - _BAR_LABEL_IN - left_in) / _BAR_IN, 0.5)
    return bar


def add_head(figure: Figure, panel: Axes, heading: str = "") -> None:
    """A heading, and below it the legend of a panel, above all panels. The figure grows, the panels stay in place."""
    panels_in = float(figure.get_figheight())
    legend = _legend_in_rows(figure, panel)
    legend_in = legend.get_window_extent().height / figure.dpi if legend is not None else 0.0
    height_in = panels_in + legend_in + (_HEADING_IN if heading else 0.0)
    figure.set_figheight(height_in)
    for axes in figure.axes:
        x, y, wide, high = axes.get_position(original=True).bounds
        axes.set_position((x, y * panels_in / height_in, wide, high * panels_in / height_in))
    if legend is not None:
        corner = (panel.get_position(original=True).x0, panels_in / height_in)
        legend.set_bbox_to_anchor(corner, transform=figure.transFigure)
    if heading:
        title: dict[str, Any] = {"x": 0.01, "ha": "left", "va": "top", "fontsize": 10.5, "fontweight": "bold"}
        figure.suptitle(heading, y=1 - 0.08 / height_in, **title)


def _legend_in_rows(figure: Figure, panel: Axes) -> Legend | None:
    """The legend of a panel, from its left edge, in as few rows as do not reach beyond the last panel or bar."""
    handles, labels = panel.get_legend_handles_labels()
    right = max(axes.get_position(original=True).x1 for axes in figure.axes)
    free_px = (right - panel.get_position(original=True).x0) * figure.bbox.width
    for rows in range(1, len(handles) + 1):
        legend = figure.legend(
            handles,
            labels,
            loc="lower left",
            ncols=-(-len(handles) // rows),
            borderaxespad=0.0,
            handlelength=1.6,
            columnspacing=1.4,
        )
        if rows == len(handles) or legend.get_window_extent().width <= free_px:
            style.enlarge_dots(legend)
            return legend
        legend.remove()
    return None
