from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import AxesImage
from numpy.testing import assert_allclose, assert_array_equal

from quadlog.results.plots import planner_comparison as comparison_paths
from quadlog.results.plots.planner_comparison import PathScene, draw_cells, draw_paths, draw_ratios, same_paths
from quadlog.results.plots.style import ROBOT, TARGET, render_png

ASTAR = np.array([100, 80, 60, 40])
IA_STAR = np.array([90, 0, 70, 5])
SCRATCH = {"ia_star": np.array([True, False, True, False])}


def test_each_planner_has_a_panel_with_the_baseline_behind_it() -> None:
    cells = {"astar": ASTAR, "ia_star": IA_STAR, "dijkstra": 3 * ASTAR}
    figure = draw_cells(cells, SCRATCH, "astar", "forest:0.2")
    assert [panel.get_title() for panel in figure.axes] == ["ia_star   (2 of 4 from scratch)", "dijkstra"]
    baseline, planner, rings = figure.axes[0].get_lines()
    assert_array_equal(baseline.get_ydata(), ASTAR)
    assert_array_equal(planner.get_ydata(), IA_STAR)
    assert_array_equal(np.transpose(rings.get_data()), [[0, 90], [2, 70]])
    assert len(figure.axes[1].get_lines()) == 2  # dijkstra always begins anew: no rings


def test_rings_do_not_hide_a_line_that_is_nothing_but_restarts() -> None:
    figure = draw_cells({"astar": ASTAR, "ia_star": IA_STAR}, {"ia_star": IA_STAR > 0}, "astar", "x")
    assert figure.axes[0].get_title() == "ia_star   (3 of 4 from scratch)"
    assert len(figure.axes[0].get_lines()) == 2


def test_counts_of_more_than_two_decades_are_logarithmic_and_zero_has_a_place() -> None:
    for counts, scale in ((IA_STAR, "linear"), (np.array([10000, 0, 3, 1]), "symlog")):
        figure = draw_cells({"astar": ASTAR, "ia_star": counts}, {}, "astar", "x")
        (panel,) = figure.axes
        assert panel.get_yscale() == scale
        low, high = panel.get_ylim()
        assert low == 0
        assert high > counts.max()


def test_a_peak_of_a_long_episode_is_kept() -> None:
    counts = np.full(50_000, 10)
    counts[31_234] = 400
    figure = draw_cells({"ia_star": counts}, {}, "astar", "x")
    (line,) = figure.axes[0].get_lines()
    assert len(line.get_ydata()) < 5000
    assert np.max(line.get_ydata()) == 400


def test_ratios_are_sorted_coloured_and_written_out() -> None:
    ratios = {"astar": np.ones(5), "dijkstra": np.full(5, 0.2), "ia_star": np.array([4.0, 5, 6, np.nan, 5])}
    medians = {"astar": (1.0, 1.0, 1.0), "dijkstra": (0.2, 0.2, 0.2), "ia_star": (5.0, 4.5, 5.5)}
    figure = draw_ratios(ratios, medians, "astar", "forest:0.2")
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


OCCUPIED = np.zeros((4, 6), dtype=bool)
OCCUPIED[1, 3] = True
GROWN = OCCUPIED | np.roll(OCCUPIED, 1, axis=1)
WAY = np.array([[0.05, 0.05], [0.15, 0.15], [0.55, 0.35]])
DETOUR = np.array([[0.05, 0.05], [0.05, 0.35], [0.55, 0.35]])
SCENE = PathScene(
    title="maze",
    occupied=OCCUPIED,
    grown=GROWN,
    paths={"astar": WAY, "ea_star": DETOUR, "ia_star": WAY, "lpa_star": np.empty((0, 2))},
    start=WAY[0],
    goal=WAY[-1],
    cell=0.1,
)


def image_of(scene: PathScene) -> AxesImage:
    (image,) = draw_paths(scene).axes[0].get_images()
    return image


def test_the_map_stands_where_the_paths_are_with_rows_upwards() -> None:
    image = image_of(replace(SCENE, origin=(2.0, -1.0)))
    assert_array_equal(image.get_array(), np.where(OCCUPIED, 2, GROWN))
    assert image.origin == "lower"
    assert_allclose(image.get_extent(), (2.0, 2.6, -1.0, -0.6))


def test_planners_with_one_path_share_a_line_and_one_without_has_none() -> None:
    assert same_paths(SCENE.paths) == [["astar", "ia_star"], ["ea_star"]]
    figure = draw_paths(SCENE)
    (axes,) = figure.axes
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert list(lines) == ["astar, ia_star", "ea_star", "start", "goal"]
    assert_array_equal(lines["ea_star"].get_xydata(), DETOUR)
    entries = [text.get_text() for text in axes.get_legend().get_texts()]
    assert entries == ["growth", "obstacle", *lines]


def test_lines_on_the_same_cells_lie_beside_one_another() -> None:
    figure = draw_paths(replace(SCENE, paths={"astar": WAY, "ea_star": np.vstack([WAY, WAY[-1:]])}))
    first, second = (line.get_transform().transform(WAY) for line in figure.axes[0].get_lines()[:2])
    apart = second - first
    assert_allclose(apart, np.broadcast_to(apart[0], apart.shape))  # the same everywhere, whatever the zoom
    assert 4 < np.hypot(*apart[0]) < 6  # 2.2 points of 1/72 inch at 150 dpi
    assert abs(apart[0] @ (WAY[-1] - WAY[0])) < 1e-9


def test_large_maps_are_drawn_coarser_and_keep_thin_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison_paths, "MAX_PIXELS", 30)
    wall = np.zeros((9, 17), dtype=bool)
    wall[:, 8] = True
    image = image_of(replace(SCENE, occupied=wall, grown=None))
    pixels = np.asarray(image.get_array())
    assert pixels.size <= 30
    assert (pixels == 2).any(axis=1).all()
    assert_allclose(image.get_extent(), (0, 1.8, 0, 0.9))  # whole pixels of 3 x 3 cells


@pytest.mark.parametrize(
    "scene",
    [
        replace(SCENE, title="price $\\nosuch $ \ud800\n"),
        replace(SCENE, paths={"astar": WAY[:1]}, goal=WAY[0]),
        replace(SCENE, paths={}),
    ],
    ids=["hostile title", "start at the goal", "no path"],
)
def test_any_scene_is_a_picture(scene: PathScene) -> None:
    assert render_png(lambda: draw_paths(scene))


def test_row_zero_may_be_the_upper_one():
    """As MovingAI counts: the axis is turned over, what lies on it is not."""
    for down, limits in ((False, (0, 0.4)), (True, (0.4, 0))):
        figure = draw_paths(replace(SCENE, y_goes_down=down))
        figure.draw_without_rendering()  # gives both axes one scale
        (axes,) = figure.axes
        assert_allclose(axes.get_ylim(), limits)
        (image,) = axes.get_images()
        assert_allclose(image.get_extent(), (0, 0.6, 0, 0.4))
        assert image.origin == "lower"
        way, detour = axes.lines[:2]
        assert_allclose(way.get_xydata(), WAY)
        # On the screen the second line lies left of the first, straight across the way from start to goal.
        apart = detour.get_transform().transform(WAY) - way.get_transform().transform(WAY)
        along = axes.transData.transform(WAY[-1]) - axes.transData.transform(WAY[0])
        assert (along[0] * apart[:, 1] - along[1] * apart[:, 0] > 0).all()
        assert_allclose(apart @ along, 0, atol=0.02 * np.hypot(*along))
