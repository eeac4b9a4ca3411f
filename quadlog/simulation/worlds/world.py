"""Planner test worlds of static and moving rectangles and discs, and a body's clearance to occupied cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.compiled import kernel
from quadlog.mapping.grid import Window, crop
from quadlog.messages import Float, Int
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

    A cell is taken as the disc that fits into it, so the distance is that to its centre less cell_m / 2. Of a centre
    inside the body it is the way out, through the nearest side, with a minus.
    """
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    nearest, deepest = math.inf, 0.0
    for i in range(len(centres_m)):
        dx, dy = centres_m[i, 0] - x_m, centres_m[i, 1] - y_m
        outside_x, outside_y = abs(cos * dx + sin * dy) - length_m / 2, abs(cos * dy - sin * dx) - width_m / 2
        deepest = min(deepest, max(outside_x, outside_y))
        outside_x = outside_x if outside_x > 0 else 0.0
        outside_y = outside_y if outside_y > 0 else 0.0
        squared = outside_x * outside_x + outside_y * outside_y
        if squared < nearest:
            nearest = squared
    return math.sqrt(nearest) + deepest - cell_m / 2


def body_gaps(pose: Float, length_m: float, width_m: float, centres_m: Float, cell_m: float) -> Float:
    """(N,) the same to each of the cells; pose: (3,) x_m, y_m, yaw_rad."""
    x_m, y_m, yaw_rad = pose.tolist()
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    dx, dy = (centres_m - np.array([x_m, y_m])).T
    outside_x, outside_y = np.abs(cos * dx + sin * dy) - length_m / 2, np.abs(cos * dy - sin * dx) - width_m / 2
    inside = np.minimum(np.maximum(outside_x, outside_y), 0.0)
    return np.asarray(np.hypot(np.maximum(outside_x, 0.0), np.maximum(outside_y, 0.0)) + inside - cell_m / 2)


# Printed in [Planning, section 4].
CELL_M = 0.1
WINDOW_CELLS = 40
GROWTH_M = 0.3
SPEED_MPS = 0.285
"""Table 1 of [Planning]: the ten lengths of A* over the ten times."""


@dataclass(frozen=True, slots=True)
class WaypointTrack:
    """A point that goes straight and evenly between instants t_ns (K,), K >= 1, at xy_m (K, 2); else it stands."""

    t_ns: Int
    xy_m: Float

    def at(self, t_ns: int) -> Float:
        """Where it is (2,) in map."""
        return np.array([np.interp(t_ns, self.t_ns, self.xy_m[:, axis]) for axis in (0, 1)])


def standing(x_m: float, y_m: float) -> WaypointTrack:
    """A point that never moves."""
    return WaypointTrack(np.zeros(1, dtype=np.int64), np.array([[x_m, y_m]]))


@dataclass(frozen=True, slots=True)
class World:
    """Occupied cells (rows, cols) of a window of the lattice, undilated, and who walks there.

    start_xy_m: (2,) in map, where the robot is at t_ns = 0; goal: where it is to go.
    window_cells: the robot sees a square of so many cells about it, in which
    obstacles grow by dilation_m in a shape of `goal_projection.INFLATIONS`.
    moving: tracks and radii in metres of discs, who are somewhere else at every instant.
    """

    window: Window
    occupied: Bool
    start_xy_m: Float
    goal: WaypointTrack
    moving: tuple[tuple[WaypointTrack, float], ...] = ()
    window_cells: int = WINDOW_CELLS
    dilation_m: float = GROWTH_M
    dilation: str = "euclidean"
    speed_mps: float = SPEED_MPS

    def occupied_in(self, window: Window, t_ns: int) -> Bool:
        """Occupied cells (rows, cols) of a window of its lattice at an instant; what lies outside is free."""
        occupied = crop(self.occupied, self.window, window)
        if self.moving:
            discs_m = np.array([[*track.at(t_ns), radius_m] for track, radius_m in self.moving])
            occupied |= discs_in(window, discs_m)
        return occupied


def discs_in(window: Window, discs_m: Float) -> Bool:
    """Cells (rows, cols) covered by discs (N, 3), each x, y and radius in map.

    A cell is when its centre lies in a disc, its rim included; so is the one
    that holds a disc's centre, however thin the disc.
    """
    occupied = np.zeros(window.shape, dtype=np.bool_)
    if len(discs_m) == 0:
        return occupied
    middle = window.cell_of(discs_m[:, :2])
    reach = int(np.ceil(discs_m[:, 2].max() / window.cell_m))
    aside = np.arange(-reach, reach + 1)
    around = np.stack(np.meshgrid(aside, aside), axis=-1).reshape(-1, 2)
    cells = middle[:, None, :] + around
    away_m = window.centre_of(cells) - discs_m[:, None, :2]
    covered = (away_m**2).sum(axis=2) <= discs_m[:, 2:] ** 2
    cells = np.concatenate([cells[covered], middle])
    cells = cells[window.contains(cells)]
    occupied[cells[:, 1], cells[:, 0]] = True
    return occupied


def rectangles_in(window: Window, rectangles: Sequence[tuple[float, float, float, float]]) -> Bool:
    """Cells (rows, cols) whose centre lies in a rectangle x0, y0, x1, y1 in map, its sides included."""
    occupied = np.zeros(window.shape, dtype=np.bool_)
    centres_m = window.centre_of(np.moveaxis(np.indices(window.shape)[::-1], 0, -1))
    for x0_m, y0_m, x1_m, y1_m in rectangles:
        occupied |= ((centres_m >= (x0_m, y0_m)) & (centres_m <= (x1_m, y1_m))).all(axis=2)
    return occupied
