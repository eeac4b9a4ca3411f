"""The robot seen from above, to scale: its footprint and where it looks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Pose = tuple[float, float, float]
_NOSE = 1.0  # how far the line that shows the heading sticks out, in half lengths of the body


def draw_body(axes: Axes, pose: Pose, size_m: tuple[float, float] | None, dot: float = 0.0) -> None:
    """The body at a pose (x_m, y_m, yaw_rad), length by width; a mere triangle where the size is not known.

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
