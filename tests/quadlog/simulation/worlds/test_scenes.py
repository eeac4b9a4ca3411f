from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import ndimage, stats

from quadlog.mapping.grid import Window
from quadlog.mapping.inflation import INFLATIONS
from quadlog.planning.query import make_query
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.replanning_walk import Outcome, walk_world
from quadlog.simulation.worlds.scenes import GOAL_AWAY_M, SCENES, TRUNK_RADIUS_M, forest_world, plant


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


def test_the_moving_obstacle_crosses_the_way():
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


WINDOW = Window(-30, 15, 0.1, (150, 200))
DENSITIES = (0.1, 0.3, 1.0)


@pytest.mark.parametrize("density", DENSITIES)
def test_trees_are_poisson_distributed_and_even(density):
    """Over 300 forests: the count's mean and variance, and where the trees stand, as often as chance allows."""
    rng = np.random.default_rng(4)
    forests = [plant(density, WINDOW, rng) for _ in range(300)]
    counts, expected = np.array([len(each) for each in forests]), density * 15.0 * 20.0
    total = stats.poisson(expected * len(counts))
    assert total.ppf(1e-4) <= counts.sum() <= total.ppf(1 - 1e-4)
    # The index of dispersion of a Poisson distribution is chi-squared.
    dispersion = ((counts - counts.mean()) ** 2).sum() / counts.mean()
    assert 1e-4 < stats.chi2(len(counts) - 1).cdf(dispersion) < 1 - 1e-4
    x_m, y_m, radius_m = np.concatenate(forests).T
    for values, low, span in (
        (x_m, -3.0, 20.0),
        (y_m, 1.5, 15.0),
        (radius_m, TRUNK_RADIUS_M[0], np.ptp(TRUNK_RADIUS_M)),
    ):
        assert stats.kstest(values, stats.uniform(low, span).cdf).pvalue > 1e-4


@pytest.mark.parametrize("density", DENSITIES)
def test_the_share_of_occupied_ground_is_that_of_random_discs(density):
    """A point is free when no trunk covers it: exp(-density pi E[r^2]), the Boolean model's void probability."""
    low, high = TRUNK_RADIUS_M
    expected = 1 - math.exp(-density * math.pi * (high**3 - low**3) / (3 * (high - low)))
    shares = np.array([forest_world(density, np.random.default_rng([8, i])).occupied.mean() for i in range(60)])
    error = shares.std(ddof=1) / math.sqrt(len(shares))
    # What is kept clear about start and goal: two discs of less than 1 m in 300 m2 and more.
    assert abs(shares.mean() - expected) < 4 * error + 0.02 * expected


def test_goals_lie_fifteen_to_twenty_five_metres_away_in_all_directions():
    goals = np.array([forest_world(0.0, np.random.default_rng(s)).goal.at(0) for s in range(400)]) - 0.05
    away_m, heading = np.hypot(*goals.T), np.arctan2(goals[:, 1], goals[:, 0])
    assert stats.kstest(away_m, stats.uniform(GOAL_AWAY_M[0], np.ptp(GOAL_AWAY_M)).cdf).pvalue > 1e-3
    assert stats.kstest(heading, stats.uniform(-math.pi, 2 * math.pi).cdf).pvalue > 1e-3


@pytest.mark.parametrize("dilation", sorted(INFLATIONS))
def test_start_and_goal_stay_clear_of_all_growth(dilation):
    for seed in range(20):
        world = forest_world(2.0, np.random.default_rng(seed), dilation=dilation)
        grown = INFLATIONS[dilation](world.occupied, world.dilation_m / world.window.cell_m)
        for place_m in (world.start_xy_m, world.goal.at(0)):
            col, row = world.window.cell_of(place_m)
            assert not grown[row, col]
        assert grown.any()


@pytest.mark.parametrize("density", [0.1, 0.3])
def test_the_window_never_leaves_the_forest(density):
    for seed in range(8):
        world = forest_world(density, np.random.default_rng([seed, 77]))
        for instant in walk_world(world, make_planner("astar"), cells_per_replan=3).instants:
            corners = np.array([[0, 0], [39, 39]]) + np.array(world.window.shift_to(instant.window))
            assert world.window.contains(corners).all()


def test_forests_depend_on_the_seed_only():
    one, same, other = (forest_world(0.2, np.random.default_rng([seed, 5])) for seed in (1, 1, 2))
    assert one.window == same.window
    np.testing.assert_array_equal(one.occupied, same.occupied)
    np.testing.assert_array_equal(one.goal.at(0), same.goal.at(0))
    assert one.goal.at(0).tolist() != other.goal.at(0).tolist()


@pytest.mark.parametrize("density", [-0.1, 2.01, math.inf, math.nan])
def test_densities_out_of_range_are_refused(density):
    with pytest.raises(ValueError, match=r"a forest has 0 to 2 trees per m2, not"):
        forest_world(density, np.random.default_rng(0))
