"""A walk through a world, replanning on the way, and what was to be planned at each instant. [Planning, section 4]

What a planner decides changes what it is asked next. So one planner leads, and
the instants of its walk can be put to all the others: the shared sequence.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.grid import Window, window_around
from quadlog.messages import Float
from quadlog.planning.protocol import Bool, Plan, Planner
from quadlog.planning.query import Growth, NoQuery, Query, make_query
from quadlog.planning.replan import Asker
from quadlog.simulation.worlds.world import World

# Four times the longest straight way of a forest: a robot that is not there by then goes in circles.
MOST_REPLANS = 1000
# Replans without a step before the robot gives up: 9 s at one cell a replan, enough for a person to pass.
PATIENCE = 25


class Outcome(StrEnum):
    """How a walk ended: in the goal's cell, without a way for too long, or after too many replans."""

    ARRIVED = "arrived"
    STUCK = "stuck"
    OUT_OF_REPLANS = "out of replans"


@dataclass(frozen=True, slots=True)
class ReplanInstant:
    """What a robot at robot_xy_m (2,) with a goal at goal_xy_m (2,), in map, could see: the question of a replan.

    occupied_bits: numpy.packbits of the window's cells, row by row.
    """

    t_ns: int
    window: Window
    occupied_bits: NDArray[np.uint8]
    robot_xy_m: Float
    goal_xy_m: Float

    @property
    def occupied(self) -> Bool:
        """Occupied cells (rows, cols) of the window, undilated."""
        rows, cols = self.window.shape
        return np.unpackbits(self.occupied_bits, count=rows * cols).view(np.bool_).reshape(rows, cols)


@dataclass(frozen=True, slots=True)
class WorldWalk:
    """A walk: one instant and one plan for each replan, and the way.

    path_xy_m: (N, 2) in map, the start and the centre of every cell stepped on, in order.
    A replan that could not be asked, because the robot was walled in, has a plan that found nothing.
    """

    instants: tuple[ReplanInstant, ...]
    plans: tuple[Plan, ...]
    path_xy_m: Float
    outcome: Outcome


def walk_world(world: World, planner: Planner, *, cells_per_replan: int = 1) -> WorldWalk:
    """Walk from the world's start to its goal, cells_per_replan cells of each plan; planner forgets what it knew.

    Obstacles grow within the window: the robot knows nothing of those outside. It walks at the world's speed; where
    there is no way, or none any nearer to the goal, it waits as long as the steps would have taken. After more than
    PATIENCE such replans in a row it is stuck. Raises ValueError unless it walks at least one cell a replan.
    """
    if cells_per_replan < 1:
        raise ValueError(f"cells_per_replan must be at least 1, not {cells_per_replan}")
    asker = Asker(planner)
    instants: list[ReplanInstant] = []
    plans: list[Plan] = []
    path_m = [world.start_xy_m]
    t_ns, waited = 0, 0
    while (outcome := _outcome(world, path_m[-1], t_ns, waited, len(plans))) is None:
        instants.append(look(world, path_m[-1], t_ns))
        window, query = instants[-1].window, asked_at(instants[-1], world)
        plans.append(asker.ask(query)[0])
        steps = plans[-1].cells
        if isinstance(query, Query) and plans[-1].found:
            # First out of the growth.
            steps = np.concatenate([query.way_out, steps])[1 : 1 + cells_per_replan]
        waited = 0 if len(steps) else waited + 1
        before = len(path_m)
        path_m.extend(window.centre_of(steps))
        walked_m = float(np.hypot(*np.diff(path_m[before - 1 :], axis=0).T).sum())
        t_ns += round(1e9 * (walked_m or cells_per_replan * window.cell_m) / world.speed_mps)
    return WorldWalk(tuple(instants), tuple(plans), np.array(path_m), outcome)


def look(world: World, robot_xy_m: Float, t_ns: int) -> ReplanInstant:
    """What a robot at a point (2,) of map sees at an instant."""
    window = window_around(robot_xy_m, world.window.cell_m, world.window_cells)
    bits = np.packbits(world.occupied_in(window, t_ns))
    return ReplanInstant(t_ns, window, bits, robot_xy_m, world.goal.at(t_ns))


def asked_at(instant: ReplanInstant, world: World) -> Query | NoQuery:
    """What is to be planned at an instant of a walk through a world."""
    ends = instant.robot_xy_m, instant.goal_xy_m
    return make_query(instant.window, instant.occupied, *ends, Growth(world.dilation_m, world.dilation))


def _outcome(world: World, robot_m: Float, t_ns: int, waited: int, replans: int) -> Outcome | None:
    if np.array_equal(world.window.cell_of(robot_m), world.window.cell_of(world.goal.at(t_ns))):
        return Outcome.ARRIVED
    if waited > PATIENCE:
        return Outcome.STUCK
    return Outcome.OUT_OF_REPLANS if replans >= MOST_REPLANS else None
