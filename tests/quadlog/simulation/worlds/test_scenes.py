from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage, stats

from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.mapping.grid import Window
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.replanning_walk import asked_at, walk_world
from quadlog.simulation.worlds.scenes import SCENES, TRUNK_RADIUS_M, forest_world, plant


def plans_on(world, walk, name):
    """What another planner answers to the questions of a walk, as (L, 2) points in map."""
    planner, last, plans = make_planner(name), None, []
    for each in walk.instants:
        query = asked_at(each, world)
        shift = (0, 0) if last is None else last.shift_to(each.window)
        plans.append(each.window.centre_of(planner.plan(query.blocked, query.start, query.goal, shift).cells))
        last = each.window
    return plans


@pytest.mark.parametrize("leader", ["astar", "ia_star", "mt_d_star_lite"])
@pytest.mark.parametrize("name", sorted(SCENES))
def test_every_scene_is_walked_to_its_goal(name, leader):
    world = SCENES[name]()
    walk = walk_world(world, make_planner(leader))
    assert walk.arrived
    assert 30 < len(walk.plans) < 200
    assert all(plan.found for plan in walk.plans)


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


@pytest.mark.parametrize("dilation", sorted(INFLATIONS))
def test_start_and_goal_stay_clear_of_all_growth(dilation):
    for seed in range(20):
        world = forest_world(2.0, np.random.default_rng(seed), dilation=dilation)
        grown = INFLATIONS[dilation](world.occupied, world.dilation_m / world.window.cell_m)
        for place_m in (world.start_xy_m, world.goal.at(0)):
            col, row = world.window.cell_of(place_m)
            assert not grown[row, col]
        assert grown.any()
