"""The distribution of range residuals of each anchor: its remaining bias, its spread, and its share of NLOS."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.ranges import residual_limit_m, shown_anchors
from quadlog.results.plots.run_data import LATE_STD, RunData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    figure.supxlabel("residual: range − predicted (m)" + (f"   ({left_out})" if left_out else ""), fontsize=10, y=0.02)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper right", ncols=3)
    return figure


def _draw_histogram(panel: Axes, clear_m: Float, nlos_m: Float, bins: Float) -> None:
    both_m = np.concatenate([clear_m, nlos_m])
    both_m = both_m[np.isfinite(both_m)]
    # The last bins also hold what lies beyond them: nothing vanishes from a histogram.
    inside = [np.clip(part[np.isfinite(part)], bins[0], bins[-1]) for part in (clear_m, nlos_m)]
    clear, late = (np.histogram(part, bins)[0] for part in inside)
    panel.stairs(clear, bins, fill=True, color=style.ROBOT, label="line of sight")
    late_label = f"late by more than {LATE_STD:g} std: NLOS"
    panel.stairs(clear + late, bins, baseline=clear, fill=True, color=style.NOTE, label=late_label)
    panel.set_ylim(bottom=0)
    panel.axvline(0, color=style.GREY, linewidth=0.8)
    if not len(both_m):
        return
    median_m = float(np.median(both_m))
    spread_m = float(np.subtract(*np.percentile(both_m, [75, 25]))) / 1.349  # a normal's standard deviation
    panel.axvline(median_m, color=style.BLACK, linewidth=1.0, linestyle="--", label="median (bias)")
    panel.annotate(
        f"bias {style.signed(median_m)} m\nspread {spread_m:.3f} m\n"
        f"NLOS {style.percent(len(nlos_m) / len(both_m))} of {style.count(len(both_m))}",
        (0, 1),
        xytext=(0, 4),
        xycoords="axes fraction",
        textcoords="offset points",
        va="bottom",
        fontsize=8.5,
    )
