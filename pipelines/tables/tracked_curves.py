"""A picture of one walk as [Tracking] has them for every course: its way, and all that it draws over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from quadlog.pipelines.tables.tracked_walks import Tracked
from quadlog.results.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from quadlog.messages import Float

LINES: dict[str, tuple[str, ...]] = {
    "speed (m/s)": ("vx_mps",),
    "yaw rate (rad/s)": ("yaw_rate_radps",),
    "torque (N m)": ("tau_00_nm", "tau_01_nm", "tau_02_nm"),
    "fuzzy gain (1)": ("k_v", "k_w"),
    "look-ahead (m)": ("lookahead_m",),
}
CALLED = {"tau_00_nm": "abduction", "tau_01_nm": "hip", "tau_02_nm": "knee", "k_v": "k_v", "k_w": "k_w"}


def draw_curves(walk: Tracked) -> Figure:
    """Eight panels; the walk must have its curves."""
    figure = style.new_figure(10.5)
    panels = figure.subplots(4, 2).ravel()
    _draw_way(panels[0], walk)
    position = {axis: walk.curves[f"{axis}_m"] - walk.curves[f"ref_{axis}_m"] for axis in "xy"}
    _draw(panels[1], walk, "position error (m)", position)
    _draw(panels[2], walk, "yaw error (rad)", {"": walk.curves["heading_error_rad"]})
    for panel, (label, names) in zip(panels[3:], LINES.items(), strict=True):
        _draw(panel, walk, label, {CALLED.get(name, ""): walk.curves[name] for name in names})
    return figure


def _draw_way(panel: Axes, walk: Tracked) -> None:
    for name, prefix, color, width in (("desired", "ref_", style.BLACK, 2.4), ("walked", "", style.RESIM, 1.0)):
        panel.plot(walk.curves[f"{prefix}x_m"], walk.curves[f"{prefix}y_m"], color=color, linewidth=width, label=name)
    panel.set_aspect("equal")
    panel.set_xlabel("x (m)")
    panel.set_ylabel("y (m)")
    style.legend_above(panel)


def _draw(panel: Axes, walk: Tracked, label: str, lines: Mapping[str, Float]) -> None:
    for color, (name, values) in zip(style.SERIES, lines.items(), strict=False):
        keep = style.thin_line(np.asarray(values))
        panel.plot(walk.t_s[keep], values[keep], color=color, label=name, linewidth=0.8)
    panel.set_xlabel("time (s)")
    panel.set_ylabel(label)
    if len(lines) > 1:
        style.legend_above(panel)
