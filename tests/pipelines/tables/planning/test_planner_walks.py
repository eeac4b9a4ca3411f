from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from quadlog.pipelines.comparison.problems import CompareOptions, counted
from quadlog.pipelines.tables.planning.planner_walks import HONEST, PAPER, PRESETS, forest_of, of_printed_runs, spend
from quadlog.simulation.worlds.world import Rectangle, rectangles_in


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)
def test_presets_are_those_of_compare_planners(preset):
    options = CompareOptions(preset=preset.name)
    assert (preset.rules, preset.baseline, preset.leader) == (options.rules, options.baseline, options.walked_by)
    assert preset.counted == counted(options)


def test_presets_walk_through_the_same_forests_and_numbers_through_others():
    paper, honest, other = (
        forest_of(0.2, number, preset, 0) for number, preset in ((3, PAPER), (3, HONEST), (4, PAPER))
    )
    np.testing.assert_array_equal(paper.occupied, honest.occupied)
    assert (paper.dilation, honest.dilation) == ("square", "euclidean")
    assert not np.array_equal(paper.start_xy_m + paper.goal.at(0), other.start_xy_m + other.goal.at(0))
    assert not np.array_equal(forest_of(0.2, 3, PAPER, 1).goal.at(0), paper.goal.at(0))


def test_a_statistic_of_printed_runs_is_of_the_first_and_its_interval_of_all():
    values = np.concatenate([np.full(9, 4.0), np.full(31, 8.0)])
    ours, (low, high) = of_printed_runs(values, 9, np.mean, np.random.default_rng(0))
    assert ours == 4.0
    # Of nine draws, each 8 with a chance of 31/40: binomial.
    expected = 4 + 4 * stats.binom.ppf([0.025, 0.975], 9, 31 / 40) / 9
    assert (low, high) == pytest.approx(tuple(expected), abs=0.46)
    assert of_printed_runs(values[:3], 9, np.min, np.random.default_rng(0)) == (4.0, (4.0, 4.0))


def test_a_walk_that_does_not_arrive_is_no_run():
    world = forest_of(0.0, 0, HONEST, 0)
    x_m, y_m = world.goal.at(0).tolist()
    ring = [(-1.6, -1.6, 1.6, -1.4), (-1.6, 1.4, 1.6, 1.6), (-1.6, -1.6, -1.4, 1.6), (1.4, -1.6, 1.6, 1.6)]
    walls = [Rectangle(x_m + x0, y_m + y0, x_m + x1, y_m + y1) for x0, y0, x1, y1 in ring]
    walled = replace(world, occupied=rectangles_in(world.window, walls))
    spent = spend([walled, world], HONEST, ("ia_star",), HONEST.leader, 0)
    assert (spent.walks, spent.arrived) == (2, 1)
    assert len(spent.left_out) == 1
    assert len(spent.ratios("ia_star")) == len(spent.cells("astar")) == 1
    assert set(spent.columns["episode"].tolist()) == {1}
    alone = spend([world], HONEST, ("ia_star",), HONEST.leader, 0)
    assert alone.cells("astar").tolist() == spent.cells("astar").tolist()
    # Each replan is asked once: the totals are the sums of the rows.
    row = alone.row("ia_star")
    assert alone.cells("ia_star").sum() == row.expanded_total
    assert alone.counting("touched", 0).cells("ia_star").sum() == row.touched_total
