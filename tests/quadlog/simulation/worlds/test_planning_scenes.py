from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import ndimage

from quadlog.mapping.inflation import INFLATIONS
from quadlog.planning.query import make_query
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.replanning_walk import Outcome, walk_world
from quadlog.simulation.worlds.scenes import SCENES


def plans_on(world, walk, name):
    """What another planner answers to the questions of a walk, as (L, 2) points in map."""
    planner, last, plans = make_planner(name), None, []
    for each in walk.instants:
        query = make_query(
            each.window, each.occupied, each.robot_xy_m, each.goal_xy_m, world.dilation_m, world.dilation
        )
        shift = (0, 0) if last is None else last.shift_to(each.window)
        plans.append(each.window.centre_of(planner.plan(query.blocked, query.start, query.goal, shift).cells))
        last = each.window
    return plans


@pytest.mark.parametrize("leader", ["astar", "ia_star", "mt_d_star_lite"])
@pytest.mark.parametrize("name", sorted(SCENES))
def test_every_scene_is_walked_to_its_goal(name, leader):
    world = SCENES[name]()
    walk = walk_world(world, make_planner(leader))
    assert walk.outcome is Outcome.ARRIVED
    assert 30 < len(walk.plans) < 200
    assert all(plan.found for plan in walk.plans)


def test_the_obstacle_is_as_large_as_printed_and_in_the_way():
    world = SCENES["single-obstacle"]()
    rows, cols = np.nonzero(world.occupied)
    assert (np.ptp(rows) + 1, np.ptp(cols) + 1, len(rows)) == (16, 16, 256)
    middle = world.window.centre_of(np.array([np.median(cols), np.median(rows)]))
    straight = (world.start_xy_m + world.goal.at(0)) / 2
    assert np.hypot(*(middle - straight)) < 0.2


def test_the_passage_is_as_wide_as_printed_and_stays_open():
    world = SCENES["passage"]()
    wall = world.occupied.any(axis=0)
    open_cells = (~world.occupied[:, wall]).sum(axis=0)
    assert (open_cells == 15).all()
    grown = INFLATIONS[world.dilation](world.occupied, world.dilation_m / world.window.cell_m)
    assert ((~grown[:, wall]).sum(axis=0) == 9).all()
    walk = walk_world(world, make_planner("astar"))
    inside = np.abs(walk.path_xy_m[:, 0] - 5.0) < 0.5
    assert inside.any()
    assert ((walk.path_xy_m[inside, 1] > 5.3) & (walk.path_xy_m[inside, 1] < 6.8)).all()
    # Around the wall there is no way within the site.
    closed = world.occupied.copy()
    closed[:, wall] = True
    assert ndimage.label(~closed)[1] == 2


def test_a_star_changes_sides_where_ia_star_goes_on():
    """The side is read off a figure, not off the planner: left or right of the box's middle, as seen from the start."""
    world = SCENES["coherence"]()
    rows, cols = np.nonzero(world.occupied)
    middle = world.window.centre_of(np.stack([cols, rows], axis=1)).mean(axis=0)

    def sides(plans):
        """Of plans that pass the box, whether to its left: where they cross the line athwart the way."""
        passing = [(each - middle) @ [[1, -1], [1, 1]] for each in plans]
        return [bool(each[np.argmin(abs(each[:, 0])), 1] > 0) for each in passing if each[0, 0] < 0 < each[-1, 0]]

    for leader in ("astar", "ia_star"):
        walk = walk_world(world, make_planner(leader))
        assert len(set(sides(plans_on(world, walk, "astar")))) == 2
    # The last walk is that of IA*.
    kept = sides(plans_on(world, walk, "ia_star"))
    assert len(kept) > 10
    assert len(set(kept)) == 1
    assert sum(plan.from_scratch for plan in walk.plans) == 1


def test_somebody_crosses_the_way():
    world = SCENES["dynamic-obstacle"]()
    seconds = np.arange(8) * 10**9
    maps = [world.occupied_in(world.window, int(t_ns)) for t_ns in seconds]
    assert all((a != b).any() for a, b in pairwise(maps))
    y_m = [world.window.centre_of(np.argwhere(each)[:, ::-1]).mean(axis=0)[1] for each in maps]
    # At 0.5 m/s, over the straight way.
    np.testing.assert_allclose(np.diff(y_m), -0.5, atol=0.05)
    assert y_m[0] > world.start_xy_m[1] > y_m[-1]
    plans = plans_on(world, walk_world(world, make_planner("astar")), "astar")
    off_line_m = [np.ptp(each[:, 1]) for each in plans]
    assert off_line_m[0] == pytest.approx(0.0)
    assert max(off_line_m) > 0.2
    assert off_line_m[-1] < 0.05


def test_nothing_moves_in_the_static_scenes():
    for name in ("single-obstacle", "passage", "complex", "static-obstacles"):
        world = SCENES[name]()
        later = world.occupied_in(world.window, 60 * 10**9)
        np.testing.assert_array_equal(world.occupied_in(world.window, 0), later)
        np.testing.assert_array_equal(world.goal.at(0), world.goal.at(60 * 10**9))
