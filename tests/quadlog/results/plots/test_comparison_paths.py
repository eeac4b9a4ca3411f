from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import AxesImage
from numpy.testing import assert_allclose, assert_array_equal

from quadlog.results.plots import planner_comparison as comparison_paths
from quadlog.results.plots.planner_comparison import PathScene, draw_paths, same_paths
from quadlog.results.plots.style import render_png

OCCUPIED = np.zeros((4, 6), dtype=bool)
OCCUPIED[1, 3] = True
GROWN = OCCUPIED | np.roll(OCCUPIED, 1, axis=1)
SEARCHED = np.zeros((4, 6), dtype=bool)
SEARCHED[0] = True
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
    searched=SEARCHED,
    searched_by="astar",
)


def image_of(scene: PathScene) -> AxesImage:
    figure = draw_paths([scene])
    assert figure is not None
    (image,) = figure.axes[0].get_images()
    return image


def test_the_map_stands_where_the_paths_are_with_rows_upwards() -> None:
    image = image_of(replace(SCENE, origin=(2.0, -1.0)))
    assert_array_equal(image.get_array(), np.where(OCCUPIED, 3, np.where(GROWN, 2, SEARCHED)))
    assert image.origin == "lower"
    assert_allclose(image.get_extent(), (2.0, 2.6, -1.0, -0.6))


def test_planners_with_one_path_share_a_line_and_one_without_has_none() -> None:
    assert same_paths([SCENE]) == [["astar", "ia_star"], ["ea_star"]]
    figure = draw_paths([SCENE])
    assert figure is not None
    (axes,) = figure.axes
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert list(lines) == ["astar, ia_star", "ea_star", "start", "goal"]
    assert_array_equal(lines["ea_star"].get_xydata(), DETOUR)
    entries = [text.get_text() for text in axes.get_legend().get_texts()]
    assert entries == ["expanded by astar", "growth", "obstacle", *lines]


def test_only_planners_that_agree_in_every_scene_share_a_line() -> None:
    other = replace(SCENE, paths={"astar": WAY, "ia_star": DETOUR})
    assert same_paths([SCENE, other]) == [["astar"], ["ea_star"], ["ia_star"]]
    figure = draw_paths([SCENE, other])
    assert figure is not None
    colours = [
        {line.get_label(): line.get_color() for line in axes.get_lines() if line.get_label() in ("astar", "ia_star")}
        for axes in figure.axes
    ]
    assert colours[0] == colours[1]
    assert len(set(colours[0].values())) == 2


def test_lines_on_the_same_cells_lie_beside_one_another() -> None:
    figure = draw_paths([replace(SCENE, paths={"astar": WAY, "ea_star": np.vstack([WAY, WAY[-1:]])})])
    assert figure is not None
    first, second = (line.get_transform().transform(WAY) for line in figure.axes[0].get_lines()[:2])
    apart = second - first
    assert_allclose(apart, np.broadcast_to(apart[0], apart.shape))  # the same everywhere, whatever the zoom
    assert 4 < np.hypot(*apart[0]) < 6  # 2.2 points of 1/72 inch at 150 dpi
    assert abs(apart[0] @ (WAY[-1] - WAY[0])) < 1e-9


def test_large_maps_are_drawn_coarser_and_keep_thin_walls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison_paths, "MAX_PIXELS", 30)
    wall = np.zeros((9, 17), dtype=bool)
    wall[:, 8] = True
    image = image_of(replace(SCENE, occupied=wall, grown=None, searched=None))
    pixels = np.asarray(image.get_array())
    assert pixels.size <= 30
    assert (pixels == 3).any(axis=1).all()
    assert_allclose(image.get_extent(), (0, 1.8, 0, 0.9))  # whole pixels of 3 x 3 cells


@pytest.mark.parametrize("scenes", [1, 2, 4, 5])
def test_any_number_of_scenes_can_be_drawn(scenes: int) -> None:
    many = [replace(SCENE, title=f"price $\\nosuch {i} $ \ud800\n") for i in range(scenes)]
    figure = draw_paths(many)
    assert figure is not None
    assert len(figure.axes) == scenes
    assert render_png(lambda: draw_paths(many))


def test_the_same_scene_is_the_same_bytes() -> None:
    assert render_png(lambda: draw_paths([SCENE])) == render_png(lambda: draw_paths([SCENE]))


def test_start_at_the_goal_and_no_path_is_a_picture_too() -> None:
    assert render_png(lambda: draw_paths([replace(SCENE, paths={"astar": WAY[:1]}, goal=WAY[0])]))
    assert render_png(lambda: draw_paths([replace(SCENE, paths={})]))
    assert draw_paths([]) is None


def test_row_zero_may_be_the_upper_one():
    """As MovingAI counts: the axis is turned over, what lies on it is not."""
    for down, limits in ((False, (0, 0.4)), (True, (0.4, 0))):
        figure = draw_paths([replace(SCENE, y_goes_down=down)])
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
