"""UWB ranges over time, their residuals at the smoothed track, and statistics of every link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.run_data import LATE_STD, RunData, Table
from quadlog.results.text.numbers import count, percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_TAGS, MAX_ANCHORS = 4, 12  # more would be too small to read; the title says how many are left out
POINTS_PER_SERIES = 3000

# In inches: the ranges with what is above them, a row of residuals; what is free above and between the panels.
_TOP_IN, _PANEL_IN, _ABOVE_IN, _BETWEEN_IN = 2.1, 1.45, 0.62, 0.45
_TOP_PANELS = 1.4  # height of the panel of ranges over that of a panel of residuals


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
    """Half height of residual axes: 99 % of the residuals, at least 0.3 m."""
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


BINS = 48


def draw_residuals(run: RunData) -> Figure | None:
    """One histogram per anchor, over all tags; late ranges stacked on top in another colour."""
    ranges = run.table("ranges")
    if ranges is None:
        return None
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    nlos = residual_m > run.late_beyond_m()
    anchors, left_out = shown_anchors(ranges["anchor"])
    columns = min(4, len(anchors))
    rows = -(-len(anchors) // columns)
    figure, panels = style.new_stack(rows, 2.9, above_in=1.15, columns=columns)
    bins = np.linspace(-1, 1, BINS + 1) * residual_limit_m(residual_m)
    for panel in panels.flat[len(anchors) :]:
        panel.set_visible(False)
    for panel, anchor in zip(panels.flat, anchors, strict=False):
        mine = ranges["anchor"] == anchor
        _draw_histogram(panel, residual_m[mine & ~nlos], residual_m[mine & nlos], bins)
        panel.set_title(f"anchor {anchor}", pad=44)
    for row in panels:
        row[0].set_ylabel("ranges per bin (count)")
        row[0].set_ylim(bottom=0)  # ends automatic limits of all panels, so not before the last is drawn
    figure.supxlabel("residual: range − predicted (m)" + (f"   ({left_out})" if left_out else ""), fontsize=10, y=0.02)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", ncols=3)
    return figure


def _draw_histogram(panel: Axes, clear_m: Float, nlos_m: Float, bins: Float) -> None:
    both_m = np.concatenate([clear_m, nlos_m])
    both_m = both_m[np.isfinite(both_m)]
    # The outermost bins include everything beyond them.
    inside = [np.clip(part[np.isfinite(part)], bins[0], bins[-1]) for part in (clear_m, nlos_m)]
    clear, late = (np.histogram(part, bins)[0] for part in inside)
    panel.stairs(clear, bins, fill=True, color=style.ROBOT, label="line of sight")
    late_label = f"late by more than {LATE_STD:g} std: NLOS"
    panel.stairs(clear + late, bins, baseline=clear, fill=True, color=style.NOTE, label=late_label)
    panel.axvline(0, color=style.GREY, linewidth=0.8)
    if not len(both_m):
        return
    median_m = float(np.median(both_m))
    spread_m = float(np.subtract(*np.percentile(both_m, [75, 25]))) / 1.349  # a normal's standard deviation
    panel.axvline(median_m, color=style.BLACK, linewidth=1.0, linestyle="--", label="median")
    words = f"median {median_m:+.3f} m\nspread {spread_m:.3f} m\n".replace("-", "−")
    panel.annotate(
        f"{words}NLOS {percent(len(nlos_m) / len(both_m))} of {count(len(both_m))}",
        (0, 1),
        xytext=(0, 4),
        xycoords="axes fraction",
        textcoords="offset points",
        va="bottom",
        fontsize=8.5,
    )


MAX_LINK_TAGS, MAX_LINK_ANCHORS = 4, 16  # more would be too small to read; the axis says how many are left out
WIDTH = 0.8  # of the place that all tags of one anchor share


def draw_uwb_links(run: RunData) -> Figure | None:
    """Per anchor, tags side by side: residual quantiles; bias and its std, filled where applied; NLOS share."""
    links, ranges = run.table("links"), run.table("ranges")
    if links is None or ranges is None:
        return None
    tags, anchors = np.unique(links["tag"]), np.unique(links["anchor"])
    figure, grid = style.new_stack(3, 2.4)
    residual_axes, bias_axes, nlos_axes = grid[:, 0]
    shown = min(len(tags), MAX_LINK_TAGS)
    for place, tag in enumerate(tags[:MAX_LINK_TAGS]):
        color = style.SERIES[place]
        mine = links["tag"] == tag
        rows = {name: column[mine] for name, column in links.items()}
        at = np.searchsorted(anchors, rows["anchor"]) + (place + 0.5) * WIDTH / shown - WIDTH / 2
        _draw_link_residuals(residual_axes, at, rows["anchor"], _on_track(ranges, int(tag)), color, f"tag {tag}")
        _draw_bias(bias_axes, at, rows, color)
        nlos_axes.bar(at, 100 * rows["nlos_share"], 0.8 * WIDTH / shown, color=color)
    left_out = [f"{len(tags) - shown} more tags"] * (len(tags) > shown)
    left_out += [f"{len(anchors) - MAX_LINK_ANCHORS} more anchors"] * (len(anchors) > MAX_LINK_ANCHORS)
    for axes in (residual_axes, bias_axes):
        axes.axhline(0, color=style.GREY, linewidth=0.8)
    residual_axes.set_ylabel("residual (m)")
    bias_axes.set_ylabel("bias ± 2 std (m)")
    nlos_axes.set_ylabel("NLOS (% of ranges)")
    nlos_axes.set_ylim(0, max(1.0, nlos_axes.get_ylim()[1]))
    nlos_axes.set_xlabel("anchor (id)" + (f"   ({' and '.join(left_out)} not shown)" if left_out else ""))
    nlos_axes.set_xticks(range(len(anchors)), [str(anchor) for anchor in anchors])
    nlos_axes.set_xlim(-0.6, min(len(anchors), MAX_LINK_ANCHORS) - 0.4)
    style.legend_above(residual_axes, columns=6)
    _explain(bias_axes, links)
    return figure


def _on_track(ranges: Table, tag: int) -> tuple[NDArray[np.int64], Float]:
    """Anchor and residual of one tag's ranges that have a prediction."""
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    mine = (ranges["tag"] == tag) & np.isfinite(residual_m)
    return ranges["anchor"][mine], residual_m[mine]


def _draw_link_residuals(
    axes: Axes, at: Float, anchors: NDArray[np.int64], of_tag: tuple[NDArray[np.int64], Float], color: str, label: str
) -> None:
    """Median as a dot, the middle half as a thick line, the middle 90 % as a thin one."""
    of_anchor, residual_m = of_tag
    for x, anchor in zip(at, anchors, strict=True):
        mine_m = residual_m[of_anchor == anchor]
        if not len(mine_m):
            continue
        q = np.percentile(mine_m, [5, 25, 50, 75, 95])
        axes.plot([x, x], [q[0], q[4]], color=color, linewidth=1.2, solid_capstyle="butt")
        axes.plot([x, x], [q[1], q[3]], color=color, linewidth=5, solid_capstyle="butt")
        axes.plot(x, q[2], "o", color="white", markeredgecolor=color, markersize=5)
    axes.plot([], [], color=color, linewidth=5, label=label)


def _draw_bias(axes: Axes, at: Float, rows: Table, color: str) -> None:
    for applied, face in ((True, color), (False, "white")):
        which = (rows["bias_applied"] == applied) & np.isfinite(rows["bias_m"])
        axes.errorbar(
            at[which],
            rows["bias_m"][which],
            2 * rows["bias_std_m"][which],
            fmt="s",
            color=color,
            markerfacecolor=face,
            markersize=5,
            elinewidth=1.2,
            capsize=2,
        )


def _explain(axes: Axes, links: Table) -> None:
    """What filled and hollow squares mean, where there are any."""
    known = np.isfinite(links["bias_m"])
    if not known.any():
        axes.annotate("no bias was estimated", (0.5, 0.5), xycoords="axes fraction", ha="center", color=style.GREY)
        return
    for applied, face, label in ((True, style.GREY, "subtracted"), (False, "white", "not applied")):
        if (links["bias_applied"][known] == applied).any():
            axes.plot([], [], "s", color=style.GREY, markerfacecolor=face, markersize=5, linestyle="none", label=label)
    style.legend_above(axes)
