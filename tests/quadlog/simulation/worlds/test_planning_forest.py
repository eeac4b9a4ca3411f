from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from quadlog.mapping.grid import Window
from quadlog.mapping.inflation import INFLATIONS
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.replanning_walk import walk_world
from quadlog.simulation.worlds.scenes import GOAL_AWAY_M, TRUNK_RADIUS_M, forest_world, plant

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


def test_the_seed_alone_decides():
    one, same, other = (forest_world(0.2, np.random.default_rng([seed, 5])) for seed in (1, 1, 2))
    assert one.window == same.window
    np.testing.assert_array_equal(one.occupied, same.occupied)
    np.testing.assert_array_equal(one.goal.at(0), same.goal.at(0))
    assert one.goal.at(0).tolist() != other.goal.at(0).tolist()


@pytest.mark.parametrize("density", [-0.1, 2.01, math.inf, math.nan])
def test_a_density_that_no_forest_has_is_refused(density):
    with pytest.raises(ValueError, match=r"a forest has 0 to 2 trees per m2, not"):
        forest_world(density, np.random.default_rng(0))
