"""Every link side by side: how its residuals spread, the bias that was found, and how often it was blocked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_TAGS, MAX_ANCHORS = 4, 16  # more would be too small to read; the axis says how many are left out
WIDTH = 0.8  # of the place that all tags of one anchor share


def draw_uwb_links(run: RunData) -> Figure | None:
    """Per anchor, tags side by side: residual quantiles; bias and its std, filled where applied; NLOS share."""
    links, ranges = run.table("links"), run.table("ranges")
    if links is None or ranges is None:
        return None
    tags, anchors = np.unique(links["tag"]), np.unique(links["anchor"])
    figure, grid = style.new_stack(3, 2.4)
    residual_axes, bias_axes, nlos_axes = grid[:, 0]
    shown = min(len(tags), MAX_TAGS)
    for place, tag in enumerate(tags[:MAX_TAGS]):
        color = style.SERIES[place]
        mine = links["tag"] == tag
        rows = {name: column[mine] for name, column in links.items()}
        at = np.searchsorted(anchors, rows["anchor"]) + (place + 0.5) * WIDTH / shown - WIDTH / 2
        _draw_residuals(residual_axes, at, rows["anchor"], _on_track(ranges, int(tag)), color, f"tag {tag}")
        _draw_bias(bias_axes, at, rows, color)
        nlos_axes.bar(at, 100 * rows["nlos_share"], 0.8 * WIDTH / shown, color=color)
    left_out = [f"{len(tags) - shown} more tags"] * (len(tags) > shown)
    left_out += [f"{len(anchors) - MAX_ANCHORS} more anchors"] * (len(anchors) > MAX_ANCHORS)
    for axes in (residual_axes, bias_axes):
        axes.axhline(0, color=style.GREY, linewidth=0.8)
    residual_axes.set_ylabel("residual (m)")
    bias_axes.set_ylabel("bias ± 2 std (m)")
    nlos_axes.set_ylabel("NLOS (% of ranges)")
    nlos_axes.set_ylim(0, max(1.0, nlos_axes.get_ylim()[1]))
    nlos_axes.set_xlabel("anchor (id)" + (f"   ({' and '.join(left_out)} not shown)" if left_out else ""))
    nlos_axes.set_xticks(range(len(anchors)), [str(anchor) for anchor in anchors])
    nlos_axes.set_xlim(-0.6, min(len(anchors), MAX_ANCHORS) - 0.4)
    style.legend_above(residual_axes, columns=6)
    _explain(bias_axes, links)
    return figure


def _on_track(ranges: Table, tag: int) -> tuple[NDArray[np.int64], Float]:
    """Anchor and residual of one tag's ranges that have a prediction."""
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    mine = (ranges["tag"] == tag) & np.isfinite(residual_m)
    return ranges["anchor"][mine], residual_m[mine]


def _draw_residuals(
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
