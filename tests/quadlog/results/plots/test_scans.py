from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.scans import CLASS_COLOR, STRIP_M, draw_scan
from quadlog.results.run.maps import CloudSample, write_cloud_samples

CLASSES = ["invalid", "cropped", "outlier", "ground", "obstacle"]


@pytest.fixture
def run(tiny_run: Path) -> Path:
    """Four points on the ground, of which one is far left; three of an obstacle; one outlier."""
    xyz_m = np.array(
        [[1, 0, 0], [2, 1, 0], [3, -1, 0], [4, 5, 0], [5, 0, 0.2], [5, 0, 0.6], [5, 3, 1.0], [6, 1, 2.5]], np.float32
    )
    label = np.array([3, 3, 3, 3, 4, 4, 4, 2], np.uint8)
    write_cloud_samples(tiny_run, [CloudSample(1_700_000_000_123_456_789, xyz_m, label, 0.0, 0.0, 0.0)], CLASSES)
    return tiny_run


def _lines(run: Path) -> tuple[Any, Any, Any]:
    figure = draw_scan(RunData(run))
    return figure, *figure.axes


def _of(axes: Any, name: str) -> np.ndarray:
    points = [
        np.column_stack(line.get_data())
        for line in axes.get_lines()
        if line.get_color() == CLASS_COLOR[name] and line.get_marker() == "."
    ]
    assert len(points) == 1
    return points[0]


def test_the_legend_counts_every_class(run: Path) -> None:
    figure, top, _ = _lines(run)
    labels = top.get_legend_handles_labels()[1]
    assert "ground: 4 (50.0 %)" in labels
    assert "obstacle: 3 (37.5 %)" in labels
    assert "outlier: 1 (12.5 %)" in labels
    assert not any("cropped" in label for label in labels)
    assert "8 points" in figure.get_suptitle()


def test_from_above_all_points_are_shown_and_from_the_side_those_near_the_robots_way(run: Path) -> None:
    _, top, side = _lines(run)
    np.testing.assert_allclose(_of(top, "ground"), [[1, 0], [2, 1], [3, -1], [4, 5]])
    np.testing.assert_allclose(_of(side, "ground"), [[1, 0], [2, 0], [3, 0]])
    np.testing.assert_allclose(_of(side, "obstacle"), [[5, 0.2], [5, 0.6]], rtol=1e-6)
    np.testing.assert_allclose(_of(side, "outlier"), [[6, 2.5]])
    dotted = sorted(line.get_ydata()[0] for line in top.get_lines() if line.get_linestyle() == ":")
    assert dotted == [-STRIP_M, STRIP_M]


def test_outliers_lie_on_top(run: Path) -> None:
    _, top, _ = _lines(run)
    order = [line.get_color() for line in top.get_lines() if line.get_marker() == "."]
    assert order[-1] == CLASS_COLOR["outlier"]
    assert len(order) == 3


def test_a_scan_with_nothing_near_the_robots_way_is_still_drawn(run: Path) -> None:
    sample = CloudSample(1, np.array([[0, 9, 0], [1, 8, 0.5]], np.float32), np.array([3, 4], np.uint8), 0, 0, 0)
    write_cloud_samples(run, [sample], CLASSES)
    _, top, side = _lines(run)
    assert len(_of(top, "ground")) == 1
    assert len(_of(side, "ground")) == 0
