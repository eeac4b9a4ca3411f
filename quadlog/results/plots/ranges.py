"""UWB ranges over time and how far each lies from what the smoothed track predicts, per tag and anchor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_TAGS, MAX_ANCHORS = 4, 12  # more would be too small to read; the title says how many are left out
POINTS_PER_SERIES = 3000

# In inches: the ranges with what is above them, a row of residuals; what is free above and between the panels.
_TOP_IN, _PANEL_IN, _ABOVE_IN, _BETWEEN_IN = 2.1, 1.45, 0.62, 0.45
_TOP_PANELS = 1.4  # the panel of ranges is so many times as high as one of residuals


def draw_ranges(run: RunData) -> Figure | None:
    """Per tag: ranges to every anchor over time, and below them one panel of residuals per anchor."""
    ranges = run.table("ranges")
    if ranges is None:
        return None
    all_tags = np.unique(ranges["tag"])
    tags = all_tags[:MAX_TAGS]
    per_tag = [_rows(ranges, ranges["tag"] == tag) for tag in tags]
    grid_rows = [_panel_rows(len(np.unique(rows["anchor"]))) for rows in per_tag]
    heights_in = [_TOP_IN + _PANEL_IN * rows + style.BELOW_IN for rows in grid_rows]
    figure = style.new_figure(sum(heights_in), layout=None)
    parts = figure.subfigures(len(tags), 1, height_ratios=heights_in, squeeze=False)
    shrink = float(figure.get_figheight()) / sum(heights_in)
    note = f" ({len(all_tags)} tags, {len(tags)} shown)" * (len(all_tags) > len(tags))
    for tag, rows, part, height_in in zip(tags, per_tag, parts[:, 0], heights_in, strict=True):
        _draw_tag(run, part, int(tag), rows, note, shrink * height_in)
    return figure


def shown_anchors(anchor: NDArray[Any]) -> tuple[list[int], str]:
    """The anchors that get a panel, and a note on those that do not."""
    anchors = [int(a) for a in np.unique(anchor)]
    left_out = len(anchors) - MAX_ANCHORS
    return anchors[:MAX_ANCHORS], f"{left_out} more anchors not shown" if left_out > 0 else ""


def residual_limit_m(residual_m: Float) -> float:
    """Half height of residual axes: nearly all residuals, but never so close that noise looks like trouble."""
    finite = np.abs(residual_m[np.isfinite(residual_m)])
    return max(0.3, 1.15 * float(np.percentile(finite, 99))) if len(finite) else 0.3


def _panel_rows(anchors: int) -> int:
    return -(-min(anchors, MAX_ANCHORS) // 4)


def _rows(table: Table, which: NDArray[Any]) -> Table:
    return {name: column[which] for name, column in table.items()}


def _draw_tag(run: RunData, part: Any, tag: int, rows: Table, note: str, height_in: float) -> None:
    anchors, left_out = shown_anchors(rows["anchor"])
    columns = min(4, len(anchors))
    panel_rows = _panel_rows(len(anchors))
    places, top_in, (wide_in, high_in) = _places(height_in, panel_rows, columns)
    grid = part.add_gridspec(1 + panel_rows, columns, **places)
    top = part.add_subplot(grid[0, :])
    style.fix_labels(top, style.WIDTH_IN - style.LEFT_IN - style.RIGHT_IN, top_in)
    limit_m = residual_limit_m(rows["range_m"] - rows["predicted_m"])
    share_with: Axes | None = None
    for index, anchor in enumerate(anchors):
        series = _rows(rows, rows["anchor"] == anchor)
        color = style.SERIES[index % len(style.SERIES)]
        keep = style.thin_points(len(series["t_ns"]), POINTS_PER_SERIES)
        seconds = run.seconds(series["t_ns"])[keep]
        top.plot(seconds, series["range_m"][keep], ".", color=color, label=f"anchor {anchor}", rasterized=True)
        panel = part.add_subplot(grid[1 + index // columns, index % columns], sharex=top, sharey=share_with)
        share_with = share_with or panel
        style.fix_labels(panel, wide_in, high_in)
        _draw_residuals(panel, seconds, _rows(series, keep), anchor, (limit_m, run.late_beyond_m()))
        panel.tick_params(labelleft=index % columns == 0)
        panel.locator_params(axis="x", nbins=4)
        if index % columns == 0:
            panel.set_ylabel("residual (m)")
        if index // columns == panel_rows - 1:
            panel.set_xlabel("time (s)")
    top.set_ylabel("range (m)")
    top.set_ylim(bottom=0)
    style.legend_above(top, columns=6)
    part.suptitle(
        f"tag {tag}{note}{' · ' * bool(left_out)}{left_out}", x=0.01, ha="left", fontsize=11, fontweight="bold"
    )


def _places(height_in: float, panel_rows: int, columns: int) -> tuple[dict[str, Any], float, tuple[float, float]]:
    """Of a part of the figure: its grid, the height of the panel on top, and width and height of those below it."""
    free_in = height_in - _ABOVE_IN - style.BELOW_IN - panel_rows * _BETWEEN_IN
    high_in = free_in / (_TOP_PANELS + panel_rows)
    wide_in = (style.WIDTH_IN - style.LEFT_IN - style.RIGHT_IN - (columns - 1) * style.BESIDE_IN) / columns
    places = {
        "left": style.LEFT_IN / style.WIDTH_IN,
        "right": 1 - style.RIGHT_IN / style.WIDTH_IN,
        "bottom": style.BELOW_IN / height_in,
        "top": 1 - _ABOVE_IN / height_in,
        # As parts of the mean height and width of a panel.
        "hspace": _BETWEEN_IN / (free_in / (1 + panel_rows)),
        "wspace": style.BESIDE_IN / wide_in,
        "height_ratios": [_TOP_PANELS] + [1.0] * panel_rows,
    }
    return places, _TOP_PANELS * high_in, (wide_in, high_in)


def _draw_residuals(panel: Axes, seconds: Float, series: Table, anchor: int, limits_m: tuple[float, float]) -> None:
    limit_m, late_beyond_m = limits_m
    residual_m = series["range_m"] - series["predicted_m"]
    nlos = residual_m > late_beyond_m
    beyond = int(np.sum(np.abs(residual_m) > limit_m))
    panel.axhline(0, color=style.GREY, linewidth=0.8)
    panel.plot(seconds[~nlos], residual_m[~nlos], ".", color=style.ROBOT, markersize=2)
    panel.plot(seconds[nlos], residual_m[nlos], "x", color=style.NOTE, markersize=3, markeredgewidth=0.8)
    panel.set_ylim(-limit_m, limit_m)
    panel.set_title(f"anchor {anchor}" + (f", {beyond} beyond" if beyond else ""), fontsize=9)
