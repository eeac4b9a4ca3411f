"""Worlds that planners walk through: random forests and the scenes of [Planning, section 4]."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from quadlog.mapping.grid import Window
from quadlog.messages import Float
from quadlog.planning.protocol import Bool
from quadlog.simulation.worlds.world import (
    CELL_M,
    GROWTH_M,
    WINDOW_CELLS,
    WaypointTrack,
    World,
    discs_in,
    rectangles_in,
    standing,
)

MOST_PER_M2 = 2.0
# The routes of Table 1 are 15 to 27 m long; the paper prints no trees.
GOAL_AWAY_M = (15.0, 25.0)
TRUNK_RADIUS_M = (0.1, 0.25)
# Margin for detours from the straight line, within which the window still shows forest on every side.
DETOUR_M = 4.0
# Between the growth of a tree and the goal, which lies up to half a cell's diagonal from the centre of its cell.
_CLEAR_M = 0.1


def forest_world(
    density_per_m2: float,
    rng: np.random.Generator,
    *,
    window_cells: int = WINDOW_CELLS,
    dilation: str = "euclidean",
) -> World:
    """A forest [Planning, Figs. 14-18], its goal 15 to 25 m from the start at (0, 0) in any direction, drawn evenly.

    Trees stand anywhere, Poisson-distributed with density_per_m2 a square metre, their radius even from 0.1 to 0.25 m,
    but none so near to start or goal that its growth reaches them. Cells of 0.1 m, and the growth, are printed in the
    paper; the trees are ours. Raises ValueError for a density that is not in 0..2.
    """
    if not 0 <= density_per_m2 <= MOST_PER_M2:
        raise ValueError(f"a forest has 0 to {MOST_PER_M2:g} trees per m2, not {density_per_m2:g}")
    away_m, heading_rad = rng.uniform(*GOAL_AWAY_M), rng.uniform(0, 2 * math.pi)
    middle_m = CELL_M / 2
    start_m = np.array([middle_m, middle_m])
    goal_m = start_m + away_m * np.array([math.cos(heading_rad), math.sin(heading_rad)])
    window = _around(start_m, goal_m, DETOUR_M + window_cells / 2 * CELL_M)
    trees_m = plant(density_per_m2, window, rng)
    # A square's corner reaches sqrt(2) times as far as its side.
    room_m = math.sqrt(2) * GROWTH_M + _CLEAR_M
    for place_m in (start_m, goal_m):
        trees_m = trees_m[np.hypot(*(trees_m[:, :2] - place_m).T) > trees_m[:, 2] + room_m]
    return World(
        window=window,
        occupied=discs_in(window, trees_m),
        start_xy_m=start_m,
        goal=standing(float(goal_m[0]), float(goal_m[1])),
        window_cells=window_cells,
        dilation=dilation,
    )


def plant(density_per_m2: float, window: Window, rng: np.random.Generator) -> Float:
    """Trunks (N, 3), each x, y and radius in map, all over a window: N is Poisson-distributed, places are even."""
    size_m = np.array([window.shape[1], window.shape[0]]) * window.cell_m
    count = rng.poisson(density_per_m2 * size_m.prod())
    places_m = window.origin_m + rng.uniform(size=(count, 2)) * size_m
    return np.column_stack([places_m, rng.uniform(*TRUNK_RADIUS_M, size=count)])


def _around(start_m: Float, goal_m: Float, margin_m: float) -> Window:
    """The window that holds both points, and margin_m on every side of them."""
    low = np.floor((np.minimum(start_m, goal_m) - margin_m) / CELL_M).astype(int)
    high = np.ceil((np.maximum(start_m, goal_m) + margin_m) / CELL_M).astype(int)
    cols, rows = (high - low).tolist()
    return Window(int(low[0]), int(low[1]), CELL_M, (rows, cols))


FOLLOWING_CELLS = 200
"""[Following]: the grid map, and so its window."""


def single_obstacle() -> World:
    """A square of 1.6 m, as printed, in the middle of the straight way; the way of 6 m is ours. [Planning] Fig. 19."""
    window, start_m, goal = _ground(8.0, 6.0), np.array([1.05, 3.05]), standing(7.05, 3.05)
    occupied = rectangles_in(window, [(3.2, 2.2, 4.8, 3.8)])
    return World(window, occupied, start_m, goal)


def passage() -> World:
    """A way through of 1.5 m, as printed, in a wall 1 m deep and 10 m long, and beside the straight line: ours.

    [Planning] Fig. 20. Three cells of growth leave 9 of its 15 cells open.
    """
    window, start_m, goal = _ground(10.0, 10.0), np.array([1.55, 5.05]), standing(8.55, 5.05)
    walls = [(4.5, 0.0, 5.5, 5.3), (4.5, 6.8, 5.5, 10.0)]
    return World(window, rectangles_in(window, walls), start_m, goal)


def complex_environment() -> World:
    """Boxes, walls and trunks with ways of 0.8 m and wider between them, all ours. [Planning] Fig. 21."""
    window, start_m, goal = _ground(14.0, 8.0), np.array([1.05, 4.05]), standing(13.05, 4.05)
    boxes = [
        (2.4, 3.2, 3.6, 4.6),
        (4.6, 0.0, 5.0, 3.4),
        (4.8, 5.0, 6.2, 6.0),
        (6.4, 2.6, 7.8, 4.2),
        (8.4, 4.8, 8.8, 8.0),
        (9.4, 1.0, 10.6, 2.2),
        (10.2, 3.4, 11.2, 4.8),
    ]
    trunks = [(3.0, 1.8, 0.2), (3.4, 6.4, 0.25), (7.2, 5.6, 0.2), (8.9, 3.2, 0.15), (6.6, 1.0, 0.25), (11.9, 2.4, 0.2)]
    occupied = rectangles_in(window, boxes) | discs_in(window, np.array(trunks))
    return World(window, occupied, start_m, goal)


def path_coherence() -> World:
    """A box in the way, and a person beyond it who walks across, so that the shorter way round changes sides.

    [Planning] Fig. 5, whose grid the text does not print: all ours. The first plan stays free throughout, so a planner
    that extends it keeps to its side, while A* plans a totally different path as soon as the other side is shorter.
    The goal lies aslant, because IA* keeps only steps that do not lead away from it, in columns and rows.
    """
    window, start_m = _ground(8.0, 8.0), np.array([1.05, 1.05])
    occupied = rectangles_in(window, [(1.9, 1.9, 2.5, 2.5)])
    return World(window, occupied, start_m, _walked(((4.05, 5.25), (5.25, 4.05)), 1.2))


def static_obstacles() -> World:
    """A person at the far side of a site of 5 m, behind what stands there. [Following] Fig. 14.

    The site is printed, and that one obstacle was put into it; a second one and both places are ours.
    """
    window = _ground(5.0, 5.0)
    boxes = [(1.4, 1.5, 2.2, 3.1), (3.2, 0.9, 3.8, 1.9)]
    return _following(window, rectangles_in(window, boxes), ())


def dynamic_obstacle() -> World:
    """Somebody crosses the way to the person, from side to side of the site of 5 m. [Following] Fig. 15.

    Only the site is printed; a radius of 0.25 m, 0.5 m/s, and when and where they cross, are ours.
    """
    window = _ground(5.0, 5.0)
    crossing = _walked(((2.85, 4.45), (2.85, 0.65)), 0.5)
    return _following(window, rectangles_in(window, []), ((crossing, 0.25),))


SCENES: dict[str, Callable[[], World]] = {
    "single-obstacle": single_obstacle,
    "passage": passage,
    "complex": complex_environment,
    "coherence": path_coherence,
    "static-obstacles": static_obstacles,
    "dynamic-obstacle": dynamic_obstacle,
}
"""Every scene by name."""


def _ground(length_m: float, width_m: float) -> Window:
    """A site with its lower-left corner at map's origin."""
    return Window(0, 0, CELL_M, (round(width_m / CELL_M), round(length_m / CELL_M)))


def _walked(corners_m: Sequence[tuple[float, float]], speed_mps: float) -> WaypointTrack:
    """From corner to corner at an even speed, from t_ns = 0."""
    xy_m = np.array(corners_m)
    legs_s = np.hypot(*np.diff(xy_m, axis=0).T) / speed_mps
    return WaypointTrack(np.rint(1e9 * np.concatenate([[0.0], np.cumsum(legs_s)])).astype(np.int64), xy_m)


def _following(window: Window, occupied: Bool, moving: tuple[tuple[WaypointTrack, float], ...]) -> World:
    return World(window, occupied, np.array([0.55, 2.25]), standing(4.55, 2.25), moving, FOLLOWING_CELLS)
