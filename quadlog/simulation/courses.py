"""The courses of [Tracking]: paths in map that a simulated robot is to follow, and how fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float

SPACING_M = 0.02
SPEED_MPS = 0.6
"""Of the line and the circle [Tracking, section 5], and of every path without a speed of its own."""


@dataclass(frozen=True, slots=True)
class Course:
    """A path (K, 2) in map to be walked from its first point to its last, starting in its direction."""

    name: str
    path_m: Float
    speed_mps: float

    @property
    def start_pose(self) -> Float:
        """(3,) x_m, y_m, yaw_rad of the first point."""
        ahead = self.path_m[np.flatnonzero((self.path_m != self.path_m[0]).any(axis=1))[:1]]
        dx, dy = (ahead[0] - self.path_m[0]).tolist() if len(ahead) else (1.0, 0.0)
        return np.array([*self.path_m[0], math.atan2(dy, dx)])


def line() -> Course:
    """From (0, 0) to (10, 10) at 0.6 m/s [Tracking, section 5.1]."""
    return Course("line", _pieces(0.0, 0.0, math.pi / 4, [(10 * math.sqrt(2), 0.0)]), SPEED_MPS)


def circle() -> Course:
    """Once round, radius 5 m, from (0, 0) along +x and to the left, at 0.6 m/s [Tracking, section 5.1]."""
    return Course("circle", _pieces(0.0, 0.0, 0.0, [(10 * math.pi, 1 / 5)]), SPEED_MPS)


def s_curve() -> Course:
    """6 m straight, a quarter, a half and a quarter of a circle of 3 m, left, right, left, 6 m straight, at 0.5 m/s.

    [Tracking, section 5.2] prints a picture of it; the lengths are ours.
    """
    quarter_m = 1.5 * math.pi
    bends = [(quarter_m, 1 / 3), (2 * quarter_m, -1 / 3), (quarter_m, 1 / 3)]
    return Course("s-curve", _pieces(0.0, 0.0, 0.0, [(6.0, 0.0), *bends, (6.0, 0.0)]), 0.5)


TROT = "trot-32s"
"""The experiment of [Foot, section 4], which `quadlog simulate` takes beside the courses: it has no path."""
COURSES: dict[str, Callable[[], Course]] = {"line": line, "circle": circle, "s-curve": s_curve}


def _pieces(x_m: float, y_m: float, heading_rad: float, pieces: list[tuple[float, float]]) -> Float:
    """Points (K, 2) along pieces of a length in metres and a curvature in 1/m each, from a pose on."""
    points = [np.array([[x_m, y_m]])]
    for length_m, curvature_1pm in pieces:
        s_m = np.linspace(0.0, length_m, math.ceil(length_m / SPACING_M) + 1)[1:]
        turned_rad = heading_rad + curvature_1pm * s_m
        if curvature_1pm == 0:
            x, y = x_m + s_m * math.cos(heading_rad), y_m + s_m * math.sin(heading_rad)
        else:
            x = x_m + (np.sin(turned_rad) - math.sin(heading_rad)) / curvature_1pm
            y = y_m - (np.cos(turned_rad) - math.cos(heading_rad)) / curvature_1pm
        points.append(np.column_stack([x, y]))
        x_m, y_m, heading_rad = float(x[-1]), float(y[-1]), float(turned_rad[-1])
    return np.concatenate(points)
