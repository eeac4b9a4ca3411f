from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from quadlog.errors import NotARun
from quadlog.results.plots.planning import draw_grid
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.maps import MapsWriter, load_maps
from quadlog.results.run.tables import read_table


def _drawn(run: Path) -> Any:
    figure = draw_grid(RunData(run))
    whole, close = figure.axes
    return figure, whole, close, {str(line.get_label()): line for line in close.get_lines()}


def _instant(run: Path, whole: Any) -> tuple[int, int]:
    """Index and t_ns of the map that was drawn."""
    maps = load_maps(run)
    shown = np.asarray(whole.images[0].get_array().filled(0), bool)
    (index,) = (k for k in range(len(maps.t_ns)) if np.array_equal(maps.occupied(k), shown))
    return index, int(maps.t_ns[index])


def test_robot_target_and_paths_are_those_of_the_map_instant(tiny_run: Path, change_json: Any) -> None:
    change_json(tiny_run / "run.json", {"config.robot": {"length_m": 0.62, "width_m": 0.26}})
    _, whole, _, lines = _drawn(tiny_run)
    _, t_ns = _instant(tiny_run, whole)
    poses, target, paths = (read_table(tiny_run, name) for name in ("poses", "target", "paths"))
    now = int(np.flatnonzero(poses["t_ns"] == t_ns)[0])
    assert lines["target"].get_xdata()[0] == target["x_m"][now]
    body = np.column_stack(lines["robot and heading"].get_data())
    nose = np.array([poses["x_m"][now], poses["y_m"][now]]) + 0.62 * np.array(
        [np.cos(poses["yaw_rad"][now]), np.sin(poses["yaw_rad"][now])]
    )
    assert np.linalg.norm(body - nose, axis=1).min() < 1e-9
    mine = paths["t_ns"] == t_ns
    np.testing.assert_array_equal(lines["path, cells"].get_xdata(), paths["x_m"][mine])
    np.testing.assert_array_equal(lines["path, smooth"].get_xdata(), paths["smooth_x_m"][mine])


def test_the_window_has_its_edge_and_cells_lie_in_it(tiny_run: Path) -> None:
    figure, whole, close, _ = _drawn(tiny_run)
    index, _ = _instant(tiny_run, whole)
    maps = load_maps(tiny_run)
    left, bottom = maps.origin_m[index]
    (edge,) = (patch for patch in whole.patches if isinstance(patch, Rectangle) and patch.get_label() == "window")
    assert edge.get_bbox().bounds == pytest.approx((left, bottom, 5.0, 6.0))
    for axes in (whole, close):
        assert axes.images[0].get_extent() == pytest.approx((left, left + 5.0, bottom, bottom + 6.0))
        assert axes.get_aspect() == 1.0
    title = figure.get_suptitle()
    assert "50 × 60 cells of 0.1 m" in title
    assert f"{int(maps.occupied(index).sum())} of them occupied" in title


def test_the_close_view_is_a_square_with_robot_target_and_path_that_the_whole_one_marks(tiny_run: Path) -> None:
    _, whole, close, lines = _drawn(tiny_run)
    (left, right), (bottom, top) = close.get_xlim(), close.get_ylim()
    assert right - left == pytest.approx(top - bottom)
    assert right - left == pytest.approx(4.0)
    for name in ("target", "path, cells", "robot"):
        x_m, y_m = (np.asarray(values) for values in lines[name].get_data())
        assert ((x_m > left) & (x_m < right) & (y_m > bottom) & (y_m < top)).all()
    (mark,) = (patch for patch in whole.patches if isinstance(patch, Rectangle) and patch.get_linestyle() == ":")
    assert mark.get_bbox().bounds == pytest.approx((left, bottom, right - left, top - bottom))


def test_a_long_path_widens_the_close_view(tiny_run: Path, change: Any) -> None:
    rise_m = 0.64 * read_table(tiny_run, "paths")["i"] - 2.4  # nearly the height of the window
    change(tiny_run, "paths", y_m=lambda y_m: y_m + rise_m)
    _, _, close, lines = _drawn(tiny_run)
    y_m = np.asarray(lines["path, cells"].get_ydata())
    bottom, top = close.get_ylim()
    assert (bottom, top) == pytest.approx((y_m.min() - 0.7, y_m.max() + 0.7))
    assert np.ptp(close.get_xlim()) == pytest.approx(top - bottom)


def test_a_target_far_outside_the_window_does_not_spread_the_close_view(tiny_run: Path, change: Any) -> None:
    change(tiny_run, "target", x_m=lambda x_m: x_m + 1e6)
    _, _, close, _ = _drawn(tiny_run)
    assert np.ptp(close.get_xlim()) < 10.0


@pytest.mark.parametrize("missing", ["target", "poses", "paths"])
def test_what_is_missing_is_left_out(tiny_run: Path, missing: str) -> None:
    (tiny_run / f"{missing}.parquet").unlink()
    _, _, _, lines = _drawn(tiny_run)
    gone = {"target": "target", "poses": "robot", "paths": "path, cells"}[missing]
    assert gone not in lines
    assert len({"target", "robot", "path, cells"} & set(lines)) == 2


def test_a_map_alone_is_drawn_about_its_middle(tiny_run: Path) -> None:
    for name in ("target", "poses", "paths"):
        (tiny_run / f"{name}.parquet").unlink()
    with MapsWriter(tiny_run / "maps.npz", 0.1, (60, 50)) as maps:
        maps.append(5, np.array([2.0, 1.0]), np.eye(60, 50, dtype=bool))
    _, _, close, lines = _drawn(tiny_run)
    assert not lines
    assert np.mean(close.get_xlim()) == pytest.approx(4.5)
    assert np.mean(close.get_ylim()) == pytest.approx(4.0)


def test_a_nonsense_size_of_the_robot_is_a_damaged_run(tiny_run: Path, change_json: Any) -> None:
    change_json(tiny_run / "run.json", {"config.robot": {"length_m": "long"}})
    with pytest.raises(NotARun, match=r"config\.robot"):
        draw_grid(RunData(tiny_run))
