"""What a planner is asked at one instant: start and goal on the grown map of a window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.goal_projection import INFLATIONS, escape_start, project_goal
from quadlog.mapping.grid import Window
from quadlog.messages import Float
from quadlog.planning.protocol import Bool, Cell, Cells


class Growth(NamedTuple):
    """How obstacles grow: by metres, in a shape of `goal_projection.INFLATIONS`."""

    metres: float = 0.3
    shape: str = "euclidean"


@dataclass(frozen=True, slots=True)
class Query:
    """Start and goal (col, row) of the window on blocked (rows, cols), its grown map.

    goal_projected: another cell than the goal's own stands for it, see project_goal.
    way_out: (L, 2) int32 cells from the robot's own to the one before start, none unless it stood in the growth.
    """

    window: Window
    blocked: Bool
    start: Cell
    goal: Cell
    goal_projected: bool
    way_out: Cells


@dataclass(frozen=True, slots=True)
class NoQuery:
    """Why there is nothing to plan."""

    why: str


START_OUTSIDE, WALLED_IN, NO_GOAL = NoQuery("start outside"), NoQuery("walled in"), NoQuery("no goal")


def make_query(window: Window, occupied: Bool, start_xy_m: Float, goal_xy_m: Float, growth: Growth) -> Query | NoQuery:
    """The query of a robot at start_xy_m (2,) with a goal at goal_xy_m (2,), on occupied (rows, cols), in map.

    A robot inside the growth of an obstacle first leaves it by a short way, towards the goal where there are several.
    A goal that cannot be reached is stood for by a cell that can.
    Raises ValueError for a start that is not finite.
    """
    robot = _as_cell(window.cell_of(start_xy_m))
    if not window.contains(np.array(robot)):
        return START_OUTSIDE
    if not np.isfinite(goal_xy_m).all():
        return NO_GOAL
    blocked = INFLATIONS[growth.shape](occupied, growth.metres / window.cell_m)
    goal = _as_cell(window.cell_of(goal_xy_m))
    way = escape_start(occupied, blocked, robot, goal)
    if way is None:
        return WALLED_IN
    start = _as_cell(way[-1])
    planned_to = project_goal(blocked, window, start, goal_xy_m)
    return Query(window, blocked, start, planned_to, planned_to != goal, way[:-1])


def passable(query: Query, occupied: Bool, shape: str) -> Bool:
    """Cells (rows, cols) blocked for a robot that cuts across: no nearer to an obstacle than it may be, or is already.

    That is the query's own growth; about a robot that stands inside of it obstacles grow just less far than to its
    cell. occupied, shape: as the query was made of them.
    """
    if len(query.way_out) == 0:
        return query.blocked
    rows, cols = np.nonzero(occupied)
    away = np.abs(np.stack([cols, rows], axis=1) - query.way_out[0])
    away_cells = away.max(axis=1) if shape == "square" else np.hypot(*away.T)
    return INFLATIONS[shape](occupied, max(float(away_cells.min()) - BARELY_CELLS, 0.0))


BARELY_CELLS = 1e-6
"""More than what growing by a radius gives in addition."""


def _as_cell(pair: NDArray[np.integer[Any]]) -> Cell:
    return int(pair[0]), int(pair[1])
