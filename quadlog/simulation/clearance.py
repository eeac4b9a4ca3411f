"""How far a walking robot's body stays from what was seen."""

from __future__ import annotations

import math

import numpy as np

from quadlog.compiled import kernel
from quadlog.mapping.window import Window
from quadlog.messages import Float
from quadlog.planning.protocol import Bool


def occupied_centres(occupied: Bool, window: Window) -> Float:
    """The centres (N, 2) in map of the occupied cells of a window's (rows, cols)."""
    rows, cols = np.nonzero(occupied)
    return window.centre_of(np.stack([cols, rows], axis=1))


@kernel
def body_clearance(
    x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float, centres_m: Float, cell_m: float
) -> float:
    """Metres from a body, a rectangle about the pose, to the nearest occupied cell; <= 0 when they touch, or inf.

    A cell is taken as the disc that fits into it, so the distance is that to its centre less cell_m / 2.
    """
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    nearest = math.inf
    for i in range(len(centres_m)):
        dx, dy = centres_m[i, 0] - x_m, centres_m[i, 1] - y_m
        outside_x, outside_y = abs(cos * dx + sin * dy) - length_m / 2, abs(cos * dy - sin * dx) - width_m / 2
        outside_x = outside_x if outside_x > 0 else 0.0
        outside_y = outside_y if outside_y > 0 else 0.0
        squared = outside_x * outside_x + outside_y * outside_y
        if squared < nearest:
            nearest = squared
    return math.sqrt(nearest) - cell_m / 2
