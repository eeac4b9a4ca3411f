from __future__ import annotations

from functools import partial

import numpy as np

from quadlog.pipelines.tables.tracking.courses import draw_curves
from quadlog.pipelines.tables.tracking.walks import CURVES, Tracked
from quadlog.results.plots.style import render_png

T_S = np.linspace(0.0, 52.0, 400)


def walk():
    curves = {name: number + np.sin(T_S) for number, name in enumerate(CURVES)}
    return Tracked({}, T_S, np.zeros(400), curves)


def test_every_curve_is_drawn_over_the_walk():
    figure = draw_curves(walk())
    panels = figure.axes
    assert len(panels) == 8
    drawn = [line for panel in panels for line in panel.lines]
    # The way twice, errors in x, y and yaw, and the other seven; the four of the way and its reference make errors.
    assert len(drawn) == 2 + 3 + 8
    for panel in panels[1:]:
        assert panel.get_ylabel()
        for line in panel.lines:
            assert np.array_equal(line.get_xdata(), T_S)
    by_label = {line.get_label(): line.get_ydata() for line in drawn}
    assert np.allclose(by_label["knee"], CURVES.index("tau_02_nm") + np.sin(T_S))
    assert np.allclose(by_label["x"], -2.0)
    assert np.array_equal(by_label["desired"], CURVES.index("ref_y_m") + np.sin(T_S))


def test_it_becomes_a_picture():
    png = render_png(partial(draw_curves, walk()))
    assert png is not None
    assert png.startswith(b"\x89PNG")
