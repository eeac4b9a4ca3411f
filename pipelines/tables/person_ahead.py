"""Forests in which a robot follows a person who walks ahead, for the table following-2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.mapping.inflation import INFLATIONS
from quadlog.messages import Float
from quadlog.pipelines.tables.planner_walks import HELD_OUT_SEED, Preset, forest_of
from quadlog.planning.astar import AStar
from quadlog.planning.polyline import arc_lengths
from quadlog.simulation.planning_scenes import FOLLOWING_CELLS
from quadlog.simulation.planning_worlds import Track, World

# None of these is printed. The site of Figs 14 and 15 has room for a person 4 m ahead.
AHEAD_M, SPEED_MPS = 4.0, 0.6
ASIDE_M, TURN_EACH_M = 2.0, 4.0


def follow_world(density_per_m2: float, number: int, preset: Preset, seed: int, ahead_m: float = AHEAD_M) -> World:
    """A held-out forest whose goal is a person, ahead_m of way before a robot that is as fast.

    The person strolls to the forest's goal over places up to ASIDE_M beside the straight line, one for each
    TURN_EACH_M of it, round the growth of trees, and stands there in the end.
    """
    world = forest_of(density_per_m2, number, preset, seed, FOLLOWING_CELLS)
    rng = np.random.default_rng([HELD_OUT_SEED + seed, number, *b"stroll"])
    way_m = _stroll(world, rng)
    arc_m = arc_lengths(way_m)
    first = min(int(np.searchsorted(arc_m, ahead_m)), len(arc_m) - 1)
    t_ns = np.rint(1e9 * (arc_m[first:] - arc_m[first]) / SPEED_MPS).astype(np.int64)
    return replace(world, goal=Track(t_ns, way_m[first:]), speed_mps=SPEED_MPS)


def _stroll(world: World, rng: np.random.Generator) -> Float:
    """(L, 2) cells' centres in map from start to goal; a place that cannot be reached is left out."""
    # Grown alike for all presets, so that the person takes the same way in all.
    blocked = INFLATIONS["square"](world.occupied, world.dilation_m / world.window.cell_m)
    planner = AStar()
    cells = [np.asarray(world.window.cell_of(world.start_xy_m[None]), dtype=np.int32)]
    for place_m in _places(world.start_xy_m, world.goal.at(0), rng):
        (col, row), (to_col, to_row) = cells[-1][-1].tolist(), world.window.cell_of(place_m).tolist()
        cells.append(planner.plan(blocked, (col, row), (to_col, to_row)).cells[1:])
        if not len(cells[-1]):
            cells.pop()
    return world.window.centre_of(np.concatenate(cells))


def _places(start_m: Float, goal_m: Float, rng: np.random.Generator) -> Float:
    """(K, 2) in map, the goal last."""
    along_m = goal_m - start_m
    length_m = float(np.hypot(*along_m))
    left = np.array([-along_m[1], along_m[0]]) / length_m
    count = int(length_m // TURN_EACH_M)
    share = np.arange(1, count + 1) / (count + 1)
    aside_m = rng.uniform(-ASIDE_M, ASIDE_M, size=count)
    return np.concatenate([start_m + share[:, None] * along_m + aside_m[:, None] * left, goal_m[None]])
