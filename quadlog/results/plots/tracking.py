"""How far the re-simulated robot is from its plan [Tracking, eqs 45-47]."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# column, its colour, the saved mean and deviation shown beside it
_ERRORS = (
    ("error_m", "distance to the path (m)", style.ROBOT, ("eta_m", "sigma_m"), "η"),
    ("cross_track_m", "cross-track (m, left +)", style.PLAN, None, ""),
    ("time_error_m", "timed distance (m)", style.TARGET, ("eta_time_m", "sigma_time_m"), "η"),
    ("heading_error_rad", "yaw error (rad)", style.RESIM, None, ""),
)


def draw_tracking_error(run: RunData) -> Figure | None:
    """The errors of place and yaw over time, with the saved η ± σ as line and band."""
    control = run.table("control")
    if control is None:
        return None
    errors = [error for error in _ERRORS if np.isfinite(control[error[0]]).any()]
    if not errors:
        return None
    figure, grid = style.new_stack(len(errors), 2.0)
    panels = grid[:, 0]
    seconds = run.seconds(control["t_ns"])
    for panel, (column, label, color, saved, symbol) in zip(panels, errors, strict=True):
        keep = style.thin_line(control[column])
        panel.axhline(0, color=style.GREY, linewidth=0.8)
        panel.plot(seconds[keep], control[column][keep], color=color, label=column)
        if saved is not None:
            panel.set_ylim(bottom=0)  # distances
            _draw_mean(run, panel, saved, symbol)
        panel.set_ylabel(label)
        style.legend_above(panel)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw_mean(run: RunData, panel: Axes, saved: tuple[str, str], symbol: str) -> None:
    mean_m, deviation_m = (run.metric(name) for name in saved)
    if mean_m is None:
        return
    label = f"{symbol} = {mean_m:.4f} m"
    if deviation_m is not None:
        panel.axhspan(max(0.0, mean_m - deviation_m), mean_m + deviation_m, color=style.LIGHT, alpha=0.6, linewidth=0)
        label = f"{symbol} ± σ = {mean_m:.4f} ± {deviation_m:.4f} m"
    panel.axhline(mean_m, color=style.BLACK, linewidth=1.0, linestyle="--", label=label)
