"""Where a trotting body goes and how it turns, as [Foot, Figs 5-6] show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COURSE = "trot-32s"
_TO_DEG = float(np.degrees(1.0))
_PLACES = (("x_m", "x, forward (m)", 1.0), ("y_m", "y, to the left (mm)", 1e3), ("z_m", "z, height (mm)", 1e3))
_ANGLES = (("roll_rad", "roll (°)", _TO_DEG), ("pitch_rad", "pitch (°)", _TO_DEG), ("yaw_rad", "yaw (°)", _TO_DEG))
Columns = tuple[tuple[str, str, float], ...]


def draw_displacement(run: RunData) -> Figure | None:
    """x, y and z of the trunk over time, of a run of trot-32s only."""
    return _draw(run, _PLACES)


def draw_euler_angles(run: RunData) -> Figure | None:
    """Roll, pitch and yaw over time, of a run of trot-32s only."""
    return _draw(run, _ANGLES)


def _draw(run: RunData, columns: Columns) -> Figure | None:
    control = run.table("control")
    if control is None or run.record.options.get("course") != COURSE:
        return None
    figure, grid = style.new_stack(len(columns), 1.85, above_in=0.15)
    panels = grid[:, 0]
    seconds = run.seconds(control["t_ns"])
    for panel, (column, label, factor) in zip(panels, columns, strict=True):
        panel.plot(seconds, factor * control[column], color=style.RESIM, linewidth=1.0)
        panel.set_ylabel(label)
    panels[-1].set_xlabel("time (s)")
    return figure
