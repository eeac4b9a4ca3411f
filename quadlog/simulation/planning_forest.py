"""Random forests for planners to walk through, as many as there are seeds. [Planning, section 4]"""

from __future__ import annotations

import math

import numpy as np

from quadlog.mapping.window import Window
from quadlog.messages import Float
from quadlog.simulation.planning_worlds import CELL_M, GROWTH_M, WINDOW_CELLS, World, discs_in, standing

MOST_PER_M2 = 2.0
# The routes of Table 1 are 15 to 27 m long; the paper prints no trees.
GOAL_AWAY_M = (15.0, 25.0)
TRUNK_RADIUS_M = (0.1, 0.25)
# How far beside the straight line a detour may lead while the window still shows forest on every side.
DETOUR_M = 4.0
# Between the growth of a tree and the goal, which lies up to half a cell's diagonal from the centre of its cell.
_CLEAR_M = 0.1


def forest_world(
    density_per_m2: float,
    rng: np.random.Generator,
    *,
    window_cells: int = WINDOW_CELLS,
    dilation_m: float = GROWTH_M,
    dilation: str = "euclidean",
) -> World:
    """A forest with its goal 15 to 25 m from the start in any direction, both drawn evenly; the start is at (0, 0).

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
    room_m = math.sqrt(2) * dilation_m + _CLEAR_M
    for place_m in (start_m, goal_m):
        trees_m = trees_m[np.hypot(*(trees_m[:, :2] - place_m).T) > trees_m[:, 2] + room_m]
    return World(
        title=f"forest, {density_per_m2:g} trees per m²",
        figure="[Planning] Figs. 14-18",
        window=window,
        occupied=discs_in(window, trees_m),
        start_xy_m=start_m,
        goal=standing(float(goal_m[0]), float(goal_m[1])),
        window_cells=window_cells,
        dilation_m=dilation_m,
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
