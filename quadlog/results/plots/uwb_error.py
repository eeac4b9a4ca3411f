"""How far fixes and track are from the truth over time, beside the 95 % bound that they claim."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

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
        label = f"{source}: RMSE {rmse_m:.3f} m, {style.percent(within)} within the bound"
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
    """Median time and bound of equal stretches: from fix to fix the bound jumps with the error's direction."""
    parts = np.array_split(np.arange(len(seconds)), min(BOUND_BINS, len(seconds)))
    middle_s, middle_m = (np.array([np.median(values[part]) for part in parts]) for values in (seconds, bound_m))
    return middle_s, middle_m
