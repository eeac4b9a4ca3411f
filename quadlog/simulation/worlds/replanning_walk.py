"""A walk through a world, replanning on the way, and what was to be planned at each instant. [Planning, section 4]

What a planner decides changes what it is asked next. So one planner leads, and
the instants of its walk can be put to all the others: the shared sequence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True, slots=True)
class ReplanInstant:
    """What a robot at robot_xy_m (2,) with a goal at goal_xy_m (2,), in map, could see: the question of a replan.

    occupied: cells (rows, cols) of the window, undilated.
    """

    t_ns: int
    window: Window
    occupied: Bool
    robot_xy_m: Float
    goal_xy_m: Float


@dataclass(frozen=True, slots=True)
class WorldWalk:
    """A walk: one instant and one plan for each replan, and the way.

    path_xy_m: (N, 2) in map, the start and the centre of every cell stepped on, in order.
    arrived: in the goal's cell; else without a way for too long, or after too many replans.
    A replan that could not be asked, because the robot was walled in, has a plan that found nothing.
    """

    instants: tuple[ReplanInstant, ...]
    plans: tuple[Plan, ...]
    path_xy_m: Float
    arrived: bool


def walk_world(world: World, planner: Planner) -> WorldWalk:
    """Walk from the world's start to its goal, a cell of each plan; planner forgets what it knew.

    Obstacles grow within the window: the robot knows nothing of those outside. It walks at the world's speed; where
    there is no way, or none any nearer to the goal, it waits as long as the steps would have taken. After more than
    PATIENCE such replans in a row it is stuck.
    """
    asker = Asker(planner)
    instants: list[ReplanInstant] = []
    plans: list[Plan] = []
    path_m = [world.start_xy_m]
    t_ns, waited = 0, 0
    while not (arrived := _is_there(world, path_m[-1], t_ns)) and waited <= PATIENCE and len(plans) < MOST_REPLANS:
        instants.append(look(world, path_m[-1], t_ns))
        window, query = instants[-1].window, asked_at(instants[-1], world)
        plans.append(asker.ask(query)[0])
        steps = plans[-1].cells
        if isinstance(query, Query) and plans[-1].found:
            # First out of the growth.
            steps = np.concatenate([query.way_out, steps])[1:2]
        waited = 0 if len(steps) else waited + 1
        before = len(path_m)
        path_m.extend(window.centre_of(steps))
        walked_m = float(np.hypot(*np.diff(path_m[before - 1 :], axis=0).T).sum())
        t_ns += round(1e9 * (walked_m or window.cell_m) / world.speed_mps)
    return WorldWalk(tuple(instants), tuple(plans), np.array(path_m), arrived)


def look(world: World, robot_xy_m: Float, t_ns: int) -> ReplanInstant:
    """What a robot at a point (2,) of map sees at an instant."""
    window = window_around(robot_xy_m, world.window.cell_m, world.window_cells)
    return ReplanInstant(t_ns, window, world.occupied_in(window, t_ns), robot_xy_m, world.goal.at(t_ns))


def asked_at(instant: ReplanInstant, world: World) -> Query | NoQuery:
    """What is to be planned at an instant of a walk through a world."""
    ends = instant.robot_xy_m, instant.goal_xy_m
    return make_query(instant.window, instant.occupied, *ends, Growth(world.dilation_m, world.dilation))


def _is_there(world: World, robot_m: Float, t_ns: int) -> bool:
    return np.array_equal(world.window.cell_of(robot_m), world.window.cell_of(world.goal.at(t_ns)))
