from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from quadlog.results.plots import layout as places
from quadlog.results.plots import style
from quadlog.results.plots.figures import PLOTS
from quadlog.results.plots.layout import draw_body
from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.style import new_figure
from quadlog.results.run.maps import (
    CloudSample,
    DilutionGrid,
    GroundMap,
    MapsWriter,
    write_cloud_samples,
    write_dilution,
    write_ground,
)
from quadlog.results.run.tables import TABLES, read_table, write_table
from quadlog.storage.formats.tum import write_tum

DRAW = {plot.name: plot.draw for plot in PLOTS}
FIVE = ("trajectory", "uwb_geometry", "scan", "terrain", "grid")
# Metres of the map for one of the tiny run, along x and y; it walks over three by three.
SHAPES = {
    "as it is": (1.0, 1.0),
    "wide": (30.0, 0.3),
    "tall": (0.3, 30.0),
    "standing": (0.001, 0.001),
    "turned": (-50.0, 40.0),
}
TAGS = (10001, 20002, 30003, 40004, 50005)
CLASSES = ["invalid", "cropped", "outlier", "ground", "obstacle"]


def _stretch(run: Path, along: tuple[float, float]) -> None:
    """All that lies in the map is stretched, and every part that a figure may have is there."""
    for name in ("poses", "target", "fixes", "control", "paths"):
        table = read_table(run, name)
        factors = {column: along["xy".index(column[-3])] for column in table if column.endswith(("x_m", "y_m"))}
        write_table(
            run / f"{name}.parquet", TABLES[name], table | {key: by * table[key] for key, by in factors.items()}
        )
    poses = read_table(run, "poses")
    write_tum(run / "reference.tum", poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"])
    content = json.loads((run / "run.json").read_text())
    anchors = [{"id": i, "x_m": x * along[0], "y_m": y * along[1]} for i, x, y in ((0, 0, 5), (1, 6, 5), (2, 900, 0))]
    content["config"]["uwb"]["anchors"] = anchors
    (run / "run.json").write_text(json.dumps(content))
    (run / "metrics.json").write_text('{"ate_rmse_m": {"value": 0.1, "n": 40, "unit": "m"}}')
    columns, rows = (max(2, round(20 * abs(by) ** 0.5)) for by in along)
    cell_m = max(abs(by) for by in along) * 4 / max(rows, columns)
    origin_m = np.minimum(0, np.array(along) * 4)
    _write_fields(run, (rows, columns), cell_m, origin_m)


def _write_fields(run: Path, shape: tuple[int, int], cell_m: float, origin_m: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    write_ground(run, GroundMap(origin_m, cell_m, rng.normal(0, 0.004, shape), np.ones(shape, np.int64)))
    write_dilution(run, DilutionGrid(origin_m, cell_m, 0.123, 1 + rng.random(shape)))
    instants = np.unique(read_table(run, "paths")["t_ns"])
    with MapsWriter(run / "maps.npz", cell_m, shape) as maps:
        for t_ns in instants:
            maps.append(int(t_ns), origin_m, rng.random(shape) < 0.2)
    fixes = read_table(run, "fixes")
    fixes |= {"tag": np.array(TAGS)[np.arange(len(fixes["t_ns"])) % len(TAGS)]}
    write_table(run / "fixes.parquet", TABLES["fixes"], fixes)
    xyz_m = rng.normal(0, 1, (5000, 3)).astype(np.float32) * np.array([origin_m[0] + 9, 9, 1], np.float32)
    label = rng.integers(0, len(CLASSES), 5000).astype(np.uint8)
    write_cloud_samples(run, [CloudSample(1_700_000_000_123_456_789, xyz_m, label, 0.0, 0.0, 0.0)], CLASSES)


def _drawn(run: Path, name: str) -> Figure:
    """The figure as it is in the report, in the report's style."""
    figures: list[Figure | None] = []

    def draw() -> Figure | None:
        figures.append(DRAW[name](RunData(run)))
        return figures[0]

    assert style.render_png(draw)
    (figure,) = figures
    assert figure is not None
    return figure


def _boxes(figure: Figure) -> list[tuple[int, str, Bbox]]:
    """Whose, what and where in pixels: frames of panels and bars, ticks and notes, and all texts beside them."""
    beside: list[Any] = [*figure.legends, *figure.texts]
    for axes in figure.axes:
        titles = [child for child in axes.get_children() if isinstance(child, Text) and child not in axes.texts]
        beside += [text for text in (*titles, axes.xaxis.label, axes.yaxis.label) if text.get_text()]
    found: list[tuple[int, str, Any]] = [(id(each), str(each), each.get_window_extent()) for each in beside]
    for axes in figure.axes:
        found += [(id(axes), "frame", axes.get_window_extent())]
        found += [(id(axes), note.get_text(), note.get_tightbbox()) for note in axes.texts]
        for axis in (axes.xaxis, axes.yaxis):
            axis.label.set_visible(False)  # it belongs to no one, so that it is held against the ticks too
            found += [(id(axes), f"{axis.axis_name} ticks", axis.get_tightbbox())]
    return [(owner, what, box) for owner, what, box in found if box is not None and np.isfinite(box.extents).all()]


def _bare(run: Path) -> None:
    """Without what a figure can do without."""
    for name in ("target", "control", "fixes", "paths"):
        (run / f"{name}.parquet").unlink()
    for name in ("maps.npz", "reference.tum"):
        (run / name).unlink()


@pytest.mark.parametrize("name", FIVE)
@pytest.mark.parametrize("shape", SHAPES)
def test_nothing_is_cut_off_and_nothing_lies_on_something_else(tiny_run: Path, name: str, shape: str) -> None:
    _stretch(tiny_run, SHAPES[shape])
    _check(_drawn(tiny_run, name))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_path_alone_has_all_of_the_width(tiny_run: Path, shape: str) -> None:
    _stretch(tiny_run, SHAPES[shape])
    _bare(tiny_run)
    figure = _drawn(tiny_run, "trajectory")
    _check(figure)
    (panel,) = figure.axes
    assert panel.get_position().x1 * style.WIDTH_IN == pytest.approx(style.WIDTH_IN - places.EDGE_IN)


def _check(figure: Figure) -> None:
    boxes = _boxes(figure)
    for _, what, box in boxes:
        free_px = min(box.x0, box.y0, figure.bbox.x1 - box.x1, figure.bbox.y1 - box.y1)
        assert free_px > -1e-6, f"{what} is cut off: {box}"
    for (owner, what, box), (other_owner, other, other_box) in combinations(boxes, 2):
        common = Bbox.intersection(box, other_box) if owner != other_owner else None
        assert common is None or min(common.size) < 1e-6, f"{what} lies on {other}: {box}, {other_box}"
    assert figure.get_figheight() <= style.MAX_HEIGHT_IN
    for panel in (axes for axes in figure.axes if axes.get_aspect() == 1.0):
        # A map fills its place, to one scale.
        np.testing.assert_allclose(panel.get_position().bounds, panel.get_position(original=True).bounds, rtol=1e-9)
        wide_px, high_px = panel.bbox.size
        assert wide_px / np.ptp(panel.get_xlim()) == pytest.approx(high_px / np.ptp(panel.get_ylim()))


@pytest.mark.parametrize("height_m", [-99.98, 8123.41])
def test_heights_of_any_length_have_room(tiny_run: Path, height_m: float) -> None:
    rng = np.random.default_rng(3)
    write_ground(tiny_run, GroundMap(np.zeros(2), 1.0, rng.normal(height_m, 0.004, (9, 7)), np.ones((9, 7), np.int64)))
    _check(_drawn(tiny_run, "terrain"))


def test_a_map_too_flat_or_too_high_shows_more_around_its_middle() -> None:
    for extent_m in ((10.0, 110.0, 3.0, 4.0), (10.0, 11.0, 3.0, 103.0)):
        _, panel = places.new_map(extent_m)
        (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
        assert left <= extent_m[0] < extent_m[1] <= right
        assert bottom <= extent_m[2] < extent_m[3] <= top
        assert (left + right, bottom + top) == pytest.approx((sum(extent_m[:2]), sum(extent_m[2:])))
        assert min(right - left, top - bottom) > 30


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
