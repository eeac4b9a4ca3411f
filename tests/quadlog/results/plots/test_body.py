from __future__ import annotations

import numpy as np
import pytest

from quadlog.results.plots.layout import draw_body
from quadlog.results.plots.style import new_figure


@pytest.fixture
def axes():
    return new_figure(3.0).subplots()


def test_the_footprint_lies_where_the_robot_is_and_its_nose_shows_the_heading(axes):
    yaw_rad = np.deg2rad(90.0)
    draw_body(axes, (3.0, -1.0, yaw_rad), (0.6, 0.2))
    (line,) = axes.get_lines()
    outline = np.column_stack([line.get_xdata(), line.get_ydata()])
    np.testing.assert_allclose(outline.min(axis=0), [2.9, -1.3], atol=1e-12)
    np.testing.assert_allclose(outline.max(axis=0), [3.1, -0.4], atol=1e-12)
    np.testing.assert_allclose(outline[outline[:, 1].argmax()], [3.0, -0.4], atol=1e-12)
    (fill,) = axes.patches
    corners = fill.get_xy()
    np.testing.assert_allclose(corners.min(axis=0), [2.9, -1.3], atol=1e-12)
    np.testing.assert_allclose(corners.max(axis=0), [3.1, -0.7], atol=1e-12)
    assert line.get_label() == "robot and heading"


def test_a_dot_marks_a_robot_too_small_to_be_seen(axes):
    draw_body(axes, (3.0, -1.0, 0.3), (0.6, 0.2), dot=6.0)
    dot = axes.get_lines()[-1]
    assert (list(dot.get_xdata()), list(dot.get_ydata())) == ([3.0], [-1.0])


@pytest.mark.parametrize(("size_m", "yaw_rad"), [(None, 0.5), ((0.6, 0.2), np.nan), (None, np.nan)])
def test_a_robot_of_unknown_size_or_heading_is_one_mark(axes, size_m, yaw_rad):
    draw_body(axes, (3.0, -1.0, yaw_rad), size_m)
    (mark,) = axes.get_lines()
    assert (list(mark.get_xdata()), list(mark.get_ydata())) == ([3.0], [-1.0])
    assert mark.get_label() == "robot"
    assert not axes.patches
