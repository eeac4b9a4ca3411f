from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.pipelines.comparison.problems import CompareOptions, counted
from quadlog.pipelines.tables.planning.planner_walks import (
    HONEST,
    PAPER,
    PAPER_END,
    PRESETS,
    extreme_row,
    forest_of,
    spend,
)
from quadlog.simulation.worlds.world import Rectangle, rectangles_in


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)
def test_presets_are_those_of_compare_planners(preset):
    options = CompareOptions(preset=preset.name.split(",")[0], leader=preset.leader if preset is PAPER_END else None)
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


def test_the_least_of_nine_is_the_mean_over_tables_of_all_runs():
    values = np.random.default_rng(1).uniform(4, 12, 40)
    row = extreme_row("a", values[:9], values, True, 1.0, np.random.default_rng(0))
    drawn = np.random.default_rng(2).choice(values, (200_000, 9)).min(axis=1)
    assert row.ours == pytest.approx(drawn.mean(), rel=1e-3)
    assert row.paper == values[:9].min()
    assert row.low < row.ours < row.high
    assert row.reproduces == "yes"
    assert extreme_row("a", values[:9], values, False, 1.0, np.random.default_rng(0)).ours > 11
    # A table of nine with a least far above what ours have, and a contrary that ours may have.
    assert extreme_row("a", values[:9] + 8, values, True, 1.0, np.random.default_rng(0)).reproduces == "no"
    assert extreme_row("a", values[:9], values, True, row.ours, np.random.default_rng(0)).reproduces == "undecided"
    assert extreme_row("a", values[:9], values[:5], True, 1.0, np.random.default_rng(0)).reproduces == "undecided"


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
