from __future__ import annotations

import dataclasses
import gc
import io
import itertools
import re
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from quadlog.errors import NotARun, WorkerDied
from quadlog.metrics.body import JOINTS, PHASES
from quadlog.results.plots import figures as shared_drawing
from quadlog.results.plots.figures import PLOTS, SharedDrawing, render_plots
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import TABLES, read_table, write_table

# What each figure cannot be drawn without.
NEEDS = {
    "trajectory": ["poses", "target", "control", "fixes"],
    "ranges": ["ranges"],
    "residuals": ["ranges"],
    "uwb_links": ["links"],
    "uwb_geometry": ["dilution"],
    "uwb_error": ["uwb_errors"],
    "scan": ["cloud_samples"],
    "scans": ["scans"],
    "terrain": ["ground"],
    "grid": ["maps"],
    "expanded": ["plans", "resim_plans"],
    "tracking_error": ["control"],
    "lookahead": ["control"],
    "commands": ["control"],
    "posture": ["control"],
    "torques": ["control"],
    "body_torques": ["body"],
}
# Of the experiment trot-32s alone.
TROT_ONLY = ("displacement", "euler_angles")
DRAW: dict[str, Any] = {plot.name: plot.draw for plot in PLOTS}


def _with_a_body(run: Path, change: Any) -> None:
    ticks = np.arange(200)
    change(run, "control", **{f"tau_{joint:02d}_nm": np.sin(ticks + joint) for joint in range(12)}, k_v=0.1, k_w=0.2)
    change(run, "control", pitch_rad=0.01 * np.sin(ticks), roll_rad=0.01 * np.cos(ticks), z_m=0.3 + 0.001 * ticks)
    keys = list(itertools.product(("logged", "resimulated"), ("all", "shared"), JOINTS, PHASES))
    columns = dict(zip(("body", "speeds", "joint", "phase"), np.array(keys, object).T, strict=True))
    numbers = {"torque_rms_nm": 5.0 + np.arange(len(keys)) % 7, "torque_peak_nm": 30.0, "n": 100, "n_unknown": 0}
    write_table(run / "body.parquet", TABLES["body"], columns | numbers)


def test_every_figure_is_drawn_from_a_complete_run(tiny_run: Path, change: Any) -> None:
    _with_a_body(tiny_run, change)
    pictures = render_plots(RunData(tiny_run))
    assert list(pictures) == [plot.name for plot in PLOTS if plot.name not in TROT_ONLY] == list(NEEDS)
    for png in pictures.values():
        image = Image.open(io.BytesIO(png))
        image.load()
        assert image.width == 1200
        assert image.height <= 1800
        assert len(image.convert("RGB").getcolors(1 << 24) or []) > 10  # not an empty sheet


def test_what_is_drawn_is_not_kept(tiny_run: Path) -> None:
    """A folder of runs is drawn by one process."""
    run = RunData(tiny_run)
    render_plots(run, ["trajectory", "ranges"])
    assert not [each for each in gc.get_objects() if isinstance(each, Figure)]


@pytest.mark.parametrize("name", NEEDS)
def test_a_figure_without_its_data_is_left_out(tiny_run: Path, name: str) -> None:
    for needed in NEEDS[name]:
        for path in tiny_run.glob(f"{needed}.*"):
            path.unlink()
    assert DRAW[name](RunData(tiny_run)) is None


@pytest.mark.parametrize("name", NEEDS)
def test_every_axis_says_its_unit(tiny_run: Path, change: Any, name: str) -> None:
    _with_a_body(tiny_run, change)
    figure = DRAW[name](RunData(tiny_run))
    horizontal = [axes.get_xlabel() for axes in figure.axes] + [figure.get_supxlabel()]
    vertical = [axes.get_ylabel() for axes in figure.axes] + [figure.get_supylabel()]
    for labels in (horizontal, vertical):
        said = [label for label in labels if label]
        assert said
        assert all("(" in label and ")" in label for label in said), said


def test_torques_and_gains_are_drawn_only_where_a_controller_has_them(tiny_run: Path, change: Any) -> None:
    assert DRAW["torques"](RunData(tiny_run)) is None
    assert len(DRAW["lookahead"](RunData(tiny_run)).axes) == 1
    _with_a_body(tiny_run, change)
    assert len(DRAW["lookahead"](RunData(tiny_run)).axes) == 2


def test_the_tracking_error_shows_the_saved_mean_and_deviation(tiny_run: Path) -> None:
    (tiny_run / "metrics.json").write_text(
        '{"eta_m": {"value": 0.0345, "n": 9, "unit": "m"}, "sigma_m": {"value": 0.043, "n": 9, "unit": "m"}}'
    )
    labels = DRAW["tracking_error"](RunData(tiny_run)).axes[0].get_legend_handles_labels()[1]
    assert "η ± σ = 0.0345 ± 0.0430 m" in labels


def test_the_trajectory_shows_every_path_where_it_was(tiny_original: Path) -> None:
    (axes, *_) = DRAW["trajectory"](RunData(tiny_original)).axes
    lines = {str(line.get_label()): line for line in axes.get_lines()}
    poses = read_table(tiny_original, "poses")
    np.testing.assert_array_equal(lines["robot"].get_xdata(), poses["x_m"])
    np.testing.assert_array_equal(lines["robot"].get_ydata(), poses["y_m"])
    assert {"target", "re-simulated walk", "some plans", "UWB fixes", "UWB anchors"} <= set(lines)
    assert axes.get_aspect() == 1.0


def test_residual_notes_say_median_and_nlos_share(tiny_run: Path, change: Any) -> None:
    ranges = read_table(tiny_run, "ranges")
    second = ranges["anchor"] == 1
    range_m = np.where(second, ranges["predicted_m"] - 0.25, ranges["predicted_m"])
    range_m = np.where(second & (np.cumsum(second) <= 10), ranges["predicted_m"] + 0.5, range_m)
    change(tiny_run, "ranges", range_m=range_m)
    first, changed, *_ = (axes.texts[0].get_text() for axes in DRAW["residuals"](RunData(tiny_run)).axes)
    assert re.search(r"median −0.250 m\n.*\nNLOS 25.0 % of 40", changed)
    assert re.search(r"median \+0.000 m\n.*\nNLOS 0.0 %", first)


def test_columns_without_a_single_value_do_not_stop_the_report(tiny_run: Path, change: Any) -> None:
    names = ("x_m", "y_m", "error_m", "cross_track_m", "time_error_m", "heading_error_rad", "lookahead_m", "cmd_v_mps")
    change(tiny_run, "control", **dict.fromkeys(names, np.nan))
    change(tiny_run, "fixes", x_m=np.nan, y_m=np.nan)
    change(tiny_run, "ranges", range_m=np.nan)
    drawn = render_plots(RunData(tiny_run))
    assert {"trajectory", "ranges", "residuals"} <= set(drawn)
    assert not {"tracking_error", "lookahead", "commands"} & set(drawn)


@pytest.mark.parametrize("rows", [0, 1])
def test_tables_of_no_row_and_of_one_row_are_no_trouble(tiny_run: Path, rows: int) -> None:
    for name in TABLES:
        if (tiny_run / f"{name}.parquet").is_file():
            table = {column: values[:rows] for column, values in read_table(tiny_run, name).items()}
            write_table(tiny_run / f"{name}.parquet", TABLES[name], table)
    drawn = render_plots(RunData(tiny_run))
    assert ("expanded" in drawn) == (rows == 1)
    assert "grid" in drawn


def test_many_tags_and_anchors_are_drawn_in_part_and_that_is_said(tiny_run: Path) -> None:
    anchor, tag = (grid.ravel() for grid in np.meshgrid(np.arange(30), np.arange(6)))
    many = {"t_ns": np.arange(180), "tag": tag, "anchor": anchor}
    write_table(
        tiny_run / "ranges.parquet", TABLES["ranges"], many | {"range_m": 1.0, "predicted_m": 1.0, "weight": 1.0}
    )
    figure = DRAW["ranges"](RunData(tiny_run))
    assert len(figure.axes) == 4 * (1 + 12)
    words = " ".join(part.get_suptitle() for part in figure.subfigs)
    assert "6 tags, 4 shown" in words
    assert "18 more anchors not shown" in words


def test_a_long_recording_makes_small_pictures(tiny_run: Path) -> None:
    count = 100_000
    t_ns = 1_700_000_000_123_456_789 + np.arange(count) * 20_000_000
    noise = np.random.default_rng(5).normal(0, 0.1, count)
    control = {name: values[np.arange(count) % 200] for name, values in read_table(tiny_run, "control").items()}
    control |= {"t_ns": t_ns, "error_m": np.abs(noise), "cross_track_m": noise, "cmd_yaw_rate_radps": noise}
    write_table(tiny_run / "control.parquet", TABLES["control"], control)
    ranges = {name: values[np.arange(count) % 120] for name, values in read_table(tiny_run, "ranges").items()}
    ranges |= {"t_ns": t_ns, "range_m": ranges["predicted_m"] + noise}
    write_table(tiny_run / "ranges.parquet", TABLES["ranges"], ranges)
    assert sum(len(png) for png in render_plots(RunData(tiny_run)).values()) < 4_000_000


def test_damaged_files_are_named(tiny_run: Path) -> None:
    (tiny_run / "plans.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(NotARun, match=r"plans\.parquet"):
        render_plots(RunData(tiny_run))
    (tiny_run / "run.json").write_text('{"quadlog_version": "0.1.0"}')
    with pytest.raises(NotARun, match=r"run\.json: is damaged: command"):
        RunData(tiny_run)


def test_places_and_angles_are_drawn_in_the_paper_s_units_and_of_trot_alone(tiny_run: Path, change: Any) -> None:
    for name in TROT_ONLY:
        assert DRAW[name](RunData(tiny_run)) is None
    ticks = np.arange(200)
    change(tiny_run, "control", **{name: 0.1 * ticks + k for k, name in enumerate(("x_m", "y_m", "z_m"))})
    angles = ("roll_rad", "pitch_rad", "yaw_rad")
    change(tiny_run, "control", **{name: 0.01 * np.sin(ticks + k) for k, name in enumerate(angles)})
    record = dataclasses.replace(RunData(tiny_run).record, options={"course": "trot-32s", "controller": "baseline"})
    run = RunData(tiny_run, record)
    control = read_table(tiny_run, "control")
    wanted = {
        "displacement": [control["x_m"], 1e3 * control["y_m"], 1e3 * control["z_m"]],
        "euler_angles": [np.degrees(control[name]) for name in angles],
    }
    for name, columns in wanted.items():
        for panel, column in zip(DRAW[name](run).axes, columns, strict=True):
            np.testing.assert_allclose(panel.lines[0].get_ydata(), column)


class Helper(Executor):
    """One that does so many tasks before anyone asks, and is killed amid all others or never comes to them."""

    def __init__(self, does: int, *, dies: bool = False) -> None:
        self._left, self._dies = does, dies

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if self._left > 0 and future.set_running_or_notify_cancel():
            try:
                future.set_result(fn(*args, **kwargs))
            except NotARun as error:
                future.set_exception(error)
        elif self._dies and future.set_running_or_notify_cancel():
            future.set_exception(WorkerDied(-9))
        self._left -= 1
        return future


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names in the order in which anyone draws them; the pictures are the names."""
    names: list[str] = []

    def draw(run: RunData, name: str) -> dict[str, bytes]:
        names.append(name)
        return {} if name == "terrain" else {name: name.encode()}

    monkeypatch.setattr(shared_drawing, "draw_plot", draw)
    return names


ALL = [plot.name for plot in PLOTS]
HAVE = {name: name.encode() for name in ALL if name != "terrain"}


def test_alone_all_is_drawn_once(tiny_run: Path, drawn: list[str]) -> None:
    pictures = SharedDrawing(RunData(tiny_run)).finish()
    assert list(pictures.items()) == list(HAVE.items())
    assert drawn == ALL


@pytest.mark.parametrize("does", [0, 1, 7, len(ALL)])
@pytest.mark.parametrize("dies", [False, True])
def test_each_figure_is_drawn_once_wherever_they_meet(tiny_run: Path, drawn: list[str], does: int, dies: bool) -> None:
    pictures = SharedDrawing(RunData(tiny_run), Helper(does, dies=dies)).finish()
    assert list(pictures.items()) == list(HAVE.items())
    assert sorted(drawn) == sorted(ALL)
    assert drawn[:does] == ALL[:does]


def test_what_the_helper_finds_damaged_is_named(tiny_run: Path) -> None:
    (tiny_run / "poses.parquet").write_bytes(b"PAR1")
    with pytest.raises(NotARun, match=r"poses\.parquet"):
        SharedDrawing(RunData(tiny_run), Helper(len(ALL))).finish()
