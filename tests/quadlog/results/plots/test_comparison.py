from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadlog.results.plots.planner_comparison import draw_cells, draw_ratios
from quadlog.results.plots.style import ROBOT, TARGET, render_png

ASTAR = np.array([100, 80, 60, 40])
IA_STAR = np.array([90, 0, 70, 5])
SCRATCH = {"ia_star": np.array([True, False, True, False])}


def test_each_planner_has_a_panel_with_the_baseline_behind_it() -> None:
    cells = {"astar": ASTAR, "ia_star": IA_STAR, "dijkstra": 3 * ASTAR}
    figure = draw_cells(cells, SCRATCH, "astar", "forest:0.2")
    assert figure is not None
    assert [panel.get_title() for panel in figure.axes] == ["ia_star   (2 of 4 from scratch)", "dijkstra"]
    baseline, planner, rings = figure.axes[0].get_lines()
    assert_array_equal(baseline.get_ydata(), ASTAR)
    assert_array_equal(planner.get_ydata(), IA_STAR)
    assert_array_equal(np.transpose(rings.get_data()), [[0, 90], [2, 70]])
    assert len(figure.axes[1].get_lines()) == 2  # dijkstra always begins anew: no rings


def test_rings_do_not_hide_a_line_that_is_nothing_but_restarts() -> None:
    figure = draw_cells({"astar": ASTAR, "ia_star": IA_STAR}, {"ia_star": IA_STAR > 0}, "astar", "x")
    assert figure is not None
    assert figure.axes[0].get_title() == "ia_star   (3 of 4 from scratch)"
    assert len(figure.axes[0].get_lines()) == 2


def test_counts_of_more_than_two_decades_are_logarithmic_and_zero_has_a_place() -> None:
    for counts, scale in ((IA_STAR, "linear"), (np.array([10000, 0, 3, 1]), "symlog")):
        figure = draw_cells({"astar": ASTAR, "ia_star": counts}, {}, "astar", "x")
        assert figure is not None
        (panel,) = figure.axes
        assert panel.get_yscale() == scale
        low, high = panel.get_ylim()
        assert low == 0
        assert high > counts.max()


def test_a_peak_of_a_long_episode_is_kept() -> None:
    counts = np.full(50_000, 10)
    counts[31_234] = 400
    figure = draw_cells({"ia_star": counts}, {}, "astar", "x")
    assert figure is not None
    (line,) = figure.axes[0].get_lines()
    assert len(line.get_ydata()) < 5000
    assert np.max(line.get_ydata()) == 400


def test_ratios_are_sorted_coloured_and_written_out() -> None:
    ratios = {"astar": np.ones(5), "dijkstra": np.full(5, 0.2), "ia_star": np.array([4.0, 5, 6, np.nan, 5])}
    medians = {"astar": (1.0, 1.0, 1.0), "dijkstra": (0.2, 0.2, 0.2), "ia_star": (5.0, 4.5, 5.5)}
    figure = draw_ratios(ratios, medians, "astar", "forest:0.2")
    assert figure is not None
    (axes,) = figure.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["ia_star", "dijkstra"]
    assert [text.get_text() for text in axes.texts] == ["5.00  (4.50 to 5.50)", "0.200  (0.200 to 0.200)"]
    points, interval, median, *others = axes.get_lines()
    assert_array_equal(np.sort(points.get_xdata()), [4, 5, 5, 6])
    assert_array_equal(interval.get_xdata(), [4.5, 5.5])
    assert (median.get_color(), others[2].get_color()) == (ROBOT, TARGET)
    assert_array_equal(others[3].get_xdata(), [1, 1])
    assert axes.get_xscale() == "log"


@pytest.mark.parametrize("planners", [1, 2, 11])
def test_any_number_of_planners_can_be_drawn(planners: int) -> None:
    draw = np.random.default_rng(0)
    names = ["astar", *(f"planner$_{i}" for i in range(1, planners))]
    cells = {name: draw.integers(0, 500, 60) for name in names}
    ratios = {name: draw.lognormal(0, 0.02, 9) for name in names}
    medians = {name: (float(np.median(ratios[name])), None, None) for name in names}
    for picture in (
        lambda: draw_cells(cells, {}, "astar", "price $\\nosuch $ \ud800\n"),
        lambda: draw_ratios(ratios, medians, "astar", "price $\\nosuch $ \ud800\n"),
    ):
        assert (render_png(picture) is None) == (picture() is None)
        assert planners == 1 or picture() is not None


def test_nothing_to_draw_is_no_figure() -> None:
    assert draw_cells({}, {}, "astar", "x") is None
    assert draw_cells({"astar": np.empty(0, np.int64)}, {}, "astar", "x") is None
    assert draw_ratios({"astar": np.ones(3)}, {"astar": (1.0, 1.0, 1.0)}, "astar", "x") is None
