"""Every figure of a run as data and as pictures: made from what there is, whole, and the same bytes each time."""

from __future__ import annotations

import io
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from quadlog.errors import CannotWrite
from quadlog.results import mpl, scenes
from quadlog.results.figures import FIGURES, drawings_of, write_plots
from quadlog.results.find_runs import PICTURES
from quadlog.results.mpl import render
from quadlog.results.page.pack import Pack
from quadlog.results.run import Run
from quadlog.results.scenes import walk_scene
from quadlog.results.tables import TABLES, read_table, write_table
from quadlog.results.view import COLORS, Marks, Panel, Raster, Scene, Series, Track
from quadlog.storage.formats.tum import write_tum
from tests.lab.runs import change, change_json, until_ingest, with_gap, with_large_map, with_many_anchors

NAMES = {figure.name for figure in FIGURES}


def panels_of(run: Path, name: str) -> list[Panel]:
    return list(drawings_of(Run(run))[name])  # type: ignore[arg-type]


def track_of(run: Path, label: str) -> Track:
    scene = walk_scene(Run(run))
    assert scene is not None
    return next(layer for layer in scene.layers if isinstance(layer, Track) and layer.label == label)


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def test_every_figure_is_drawn_in_every_format_the_same_way_each_time(tiny_original: Path) -> None:
    drawings = drawings_of(Run(tiny_original))
    assert set(drawings) == NAMES - {
        "trot",
        "torques",
        "posture",
        "forces",
        "step_time",
    }  # of which the tiny run has nothing
    for to, begins in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        pictures = [render(drawings["trajectory"], to, width_in=3.5, point_size=8) for _ in range(2)]  # type: ignore
        assert pictures[0].startswith(begins)
        assert pictures[0] == pictures[1]


def test_figures_without_data_are_absent_and_their_old_pictures_vanish(tiny_run: Path) -> None:
    write_plots(tiny_run, drawings_of(Run(tiny_run)))
    assert {path.stem for path in (tiny_run / "plots").iterdir()} == set(PICTURES) <= {each.name for each in FIGURES}
    for name in ("notes.txt", "photo.png", "ranges.png"):
        (tiny_run / "plots" / name).write_text("the user's own")
    until_ingest(tiny_run)
    assert drawings_of(Run(tiny_run)) == {}
    write_plots(tiny_run, {})
    assert {path.name for path in (tiny_run / "plots").iterdir()} == {"notes.txt", "photo.png", "ranges.png"}
    (tiny_run / "plots").rename(tiny_run / "elsewhere")
    (tiny_run / "plots").symlink_to(tiny_run / "elsewhere")
    with pytest.raises(CannotWrite, match="link"):
        write_plots(tiny_run, {})


def test_nothing_is_joined_across_a_gap(tiny_run: Path) -> None:
    with_gap(tiny_run)
    for label in ("robot", "target", "simulated robot"):
        track = track_of(tiny_run, label)
        assert np.isnan(track.x[(track.seconds > 1.9) & (track.seconds < 31)]).any()
        assert np.isfinite(track.x[track.seconds < 1.9]).all()
    error = next(s for panel in panels_of(tiny_run, "tracking_error") for s in panel.series if s.label == "distance")
    assert np.isnan(error.y).sum() == 1


def test_all_anchors_and_tags_are_shown(tiny_run: Path) -> None:
    with_many_anchors(tiny_run)
    assert len(panels_of(tiny_run, "ranges")) == 72
    assert len(panels_of(tiny_run, "uwb_error")) == 6
    scene = walk_scene(Run(tiny_run))
    assert scene is not None
    anchors = next(layer for layer in scene.layers if layer.label == "anchors")
    assert anchors.names == [str(10 + number) for number in range(12)]  # type: ignore[union-attr]
    worst = {moment.what: moment.value for moment in scene.moments if moment.name.startswith("tag")}
    assert worst["worst error of tag 5"] == "0.3 m"
    assert len(worst) == 6


def test_walls_of_a_large_map_are_in_the_picture(tiny_run: Path) -> None:
    with_large_map(tiny_run)
    scene = walk_scene(Run(tiny_run))
    assert scene is not None
    walls = [layer for layer in scene.layers if isinstance(layer, Raster)]
    drawn = pixels(render(Scene(walls, (-20.0, 520.0, -120.0, 120.0)))).max(axis=2) < 160
    columns = np.flatnonzero(drawn[40:-100, 90:].sum(axis=0) >= 5)
    assert np.ptp(columns) == pytest.approx(500 / 540 * 859, abs=6)


def test_moments_draw_what_they_are_about(tiny_run: Path) -> None:
    control, poses = (read_table(tiny_run, name) for name in ("control", "poses"))
    write_tum(tiny_run / "reference.tum", poses["t_ns"], poses["x_m"] + 0.1, poses["y_m"], poses["yaw_rad"])
    worst = {"value": 0.2, "n": 9, "unit": "m", "worst": 0.3, "worst_t_ns": int(control["t_ns"][100])}
    later = worst | {"worst_t_ns": int(control["t_ns"][50])}
    change_json(tiny_run / "metrics.json", ate_rmse_m=worst, max_error_m=later)
    change(tiny_run, "fixes", outlier=lambda old: old | (np.arange(80) == 40))
    scene = walk_scene(Run(tiny_run))
    assert scene is not None
    layers: dict[str, Any] = {layer.label: layer for layer in scene.layers}
    link, fixes, outliers = layers["distance to the path"], layers["UWB fixes"], layers["outlying fixes"]
    lengths_m = np.hypot(*(np.diff(values.reshape(-1, 2))[:, 0] for values in (link.x, link.y)))
    assert lengths_m == pytest.approx(control["error_m"])
    assert "reference" in layers
    assert len(fixes.x) + len(outliers.x) == len(layers["95 % ellipse of the fix"].x) == 79
    assert (fixes.until - fixes.seconds) == pytest.approx(2.0)
    moments = {moment.name: moment for moment in scene.moments}
    assert (moments["ate_rmse_m"].seconds, bool(moments["ate_rmse_m"].shows)) == (pytest.approx(2.0), True)
    assert (moments["max_error_m"].seconds, moments["max_error_m"].shows) == (1.0, ())


def test_marks_are_as_many_as_the_numbers_beside_them_and_no_lane_is_the_robots_own_future(tiny_run: Path) -> None:
    scene, contacts = walk_scene(Run(tiny_run)), read_table(tiny_run, "contacts")
    marks = {of.label: len(of.x) for of in scene.layers if isinstance(of, Marks)}
    assert (marks["contact"], marks["cell inside the body"]) == (contacts["collision"].sum(), 1)
    assert "target" in scene.activity
    change(tiny_run, "target", source="ahead")
    assert "target" not in walk_scene(Run(tiny_run)).activity


def test_a_moment_draws_what_it_claims(tiny_run: Path) -> None:
    """The line is as long as the value says, whatever is thinned; a body inside an obstacle is not away from it."""
    control, poses, fixes = (read_table(tiny_run, name) for name in ("control", "poses", "fixes"))
    write_tum(tiny_run / "reference.tum", poses["t_ns"], poses["x_m"] + 0.1, poses["y_m"], poses["yaw_rad"])
    error_m = np.linspace(0.1, 0.5, 40)
    errors = {"t_ns": np.tile(poses["t_ns"], 2), "tag": np.zeros(80, int), "source": np.repeat(["fixes", "track"], 40)}
    errors |= {"error_x_m": np.tile(error_m, 2), "error_y_m": np.zeros(80), "bound_m": np.full(80, 0.2)}
    write_table(tiny_run / "uwb_errors.parquet", TABLES["uwb_errors"], errors)
    worst = {
        "ate_rmse_m": (0.1, poses["t_ns"][30]), "uwb_rmse_m": (error_m[27], poses["t_ns"][27]),
        "eta_m": (control["error_m"][143], control["t_ns"][143]), "uwb_nees": (7.0, poses["t_ns"][21]),
        "clearance_min_m": (-0.18, control["t_ns"][3]), "heading_rmse_rad": (0.3, control["t_ns"][60]),
        "expanded_mean": (9, read_table(tiny_run, "plans")["t_ns"][2]), "uwb_residual_m": (0.2, fixes["t_ns"][12]),
    }  # fmt: skip
    saved = {
        name: {"value": 0.1, "n": 9, "unit": "m", "worst": float(of), "worst_t_ns": int(at)}
        for name, (of, at) in worst.items()
    }
    change_json(tiny_run / "metrics.json", **saved)
    scene = walk_scene(Run(tiny_run))
    assert scene is not None
    moments = {moment.name: moment for moment in scene.moments}
    for name in ("ate_rmse_m", "uwb_rmse_m", "eta_m"):
        x0, y0, x1, y1 = moments[name].line
        assert np.hypot(x1 - x0, y1 - y0) == pytest.approx(worst[name][0], abs=1e-3), name
    at = np.flatnonzero((fixes["t_ns"] == poses["t_ns"][27]) & (fixes["tag"] == 0))
    assert moments["uwb_rmse_m"].line[:2] == pytest.approx([fixes["x_m"][at[0]], fixes["y_m"][at[0]]])
    assert {"UWB fixes", "95 % ellipse of the fix"} <= set(moments["uwb_rmse_m"].hides)
    assert all(len(moments[name].line) == 4 for name in worst if name != "clearance_min_m")
    assert moments["expanded_mean"].hides == ("plan, simulated walk",)
    assert len(moments["uwb_rmse_m"].ring) == len(moments["uwb_nees"].ring) == 5
    assert (moments["clearance_min_m"].what, moments["clearance_min_m"].value) == ("body", "0.18 m inside an obstacle")
    pack = Pack()
    pack.add("trajectory", scene)
    packed = pack.finish()["scenes"]["trajectory"]["moments"]
    assert [list(moment["line"]) for moment in packed] == [list(moment.line) for moment in scene.moments]


def test_the_recorded_robot_has_curves_of_its_own(tiny_run: Path) -> None:
    """On a quarter circle of 3 m at an even pace; gait where the feet are known."""
    t_ns = read_table(tiny_run, "poses")["t_ns"]
    steps = dict.fromkeys(TABLES["joints"].names, np.full(40, np.nan)) | {"t_ns": t_ns}
    steps |= {f"contact_{leg}": (np.arange(40) // 5 + leg) % 2 for leg in range(4)}
    write_table(tiny_run / "joints.parquet", TABLES["joints"], steps)
    panels = {panel.what: panel for panel in drawings_of(Run(tiny_run))["motion"]}  # type: ignore[union-attr]
    known = {series.label: series for series in panels["speed (m/s)"].series}
    assert known["recorded"].y[1:-1] == pytest.approx(3 * np.pi / 2 / 3.9, rel=0.01)
    assert known["simulated"].color == "resim"
    yaw_rate = panels["yaw rate (°/s)"].series[0].y
    assert yaw_rate == pytest.approx(90 / 3.9, rel=0.01)
    assert panels["yaw (°)"].series[0].y[-1] == pytest.approx(90)
    assert panels["feet on the ground"].rows == ("FL", "FR", "RL", "RR")
    assert panels["strides (Hz)"].series[0].y == pytest.approx(1.0)
    assert {"x (m)", "y (m)"} == {panel.what for panel in drawings_of(Run(tiny_run))["place"]}  # type: ignore[union-attr]
    with_gap(tiny_run)
    speed = {s.label: s for s in panels_of(tiny_run, "motion")[0].series}["recorded"]
    assert np.isnan(speed.y).sum() > 1
    assert speed.y[np.isfinite(speed.y)] == pytest.approx(3 * np.pi / 2 / 3.9, rel=0.02)  # and none across the gap


def test_a_long_track_is_thinned_with_a_note_a_curve_never_and_both_have_the_pages_colours() -> None:
    css = (Path(__file__).parents[3] / "quadlog/results/page/templates/app.css").read_text()
    assert all(css.count(f"--{name}:") == 2 for name in COLORS if name not in ("text", "soft", "bad"))
    seconds = np.arange(100_000) / 100
    pack = Pack()
    pack.add("curve", [Panel("a", [Series("a", "robot", seconds, np.sin(seconds))])])
    assert pack.thinned == ""
    assert pack.finish()["columns"][pack.charts["curve"]["panels"][0]["series"][0]["y"]][0] == 100_000
    x = np.where((seconds > 500) & (seconds < 530), np.nan, seconds)
    pack.add("scene", Scene([Track("robot", "robot", seconds, x, seconds)], (0, 1, 0, 1)))
    assert "positions of robot" in pack.thinned


@pytest.mark.parametrize("width_in", [2.5, 8.0])
def test_words_of_a_figure_never_cover_each_other(
    tiny_run: Path, width_in: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matplotlib says where each text is drawn: legends, quantities, notes, and names in scenes."""
    covered, seen = [], []

    def look(picture: mpl.Picture, *_: object, **__: object) -> None:
        picture.canvas.draw()  # type: ignore[attr-defined]
        texts = [text for of in (picture, *picture.axes) for text in of.texts if text.get_text()]
        boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
        seen.extend(boxes)
        covered.extend((one[0], two[0]) for one, two in combinations(boxes, 2) if one[1].overlaps(two[1]))

    monkeypatch.setattr(mpl.Picture, "savefig", look)
    for drawing in [*drawings_of(Run(tiny_run)).values(), scenes.error_scene(Run(tiny_run))]:
        render(drawing, "pdf", width_in, point_size=8.0)
    assert len(seen) > 30
    assert covered == []


def test_no_name_lies_on_a_wall() -> None:
    """An anchor has walls on three sides of it, another one on the side that is left, mirrored."""
    walls = np.full((40, 100), np.nan)
    walls[20:24, 10:50] = walls[17:24, 10:28] = walls[17:24, 32:50] = 1.0
    walls[17:19, 60:100] = walls[17:24, 60:78] = walls[17:24, 82:100] = 1.0
    anchors = Marks("anchors", "target", np.array([3.0, 8.0]), np.array([1.95, 1.95]), names=("A1", "A2"))
    scene = Scene([Raster("walls", "wall", walls, (0.0, 0.0), 0.1, 0.0, 1.0), anchors], (-0.5, 10, 0, 4))
    with mpl.styled(8.0):
        axes = mpl.picture_of(scene, 3.5, 8.0).axes[0]
        cells = axes.transData.transform(0.1 * (np.argwhere(np.isfinite(walls))[:, ::-1] + 0.5))
        assert [text.get_window_extent().count_contains(cells) for text in axes.texts] == [0, 0]


def test_a_dense_curve_is_the_range_of_each_stroke_and_nothing_is_lost_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Series] = []
    monkeypatch.setattr(mpl, "_draw_series", lambda axes, series, in_rows: drawn.append(series))
    x = np.arange(60_000) / 1000
    smooth, dense = Series("a", "robot", x, np.sin(x / 3)), Series("b", "target", x, np.sin(70 * x) + (x == 30))
    dense.y[(x > 40) & (x < 45)] = np.nan
    render([Panel("smooth", [smooth]), Panel("rows", [dense], rows="a"), Panel("dense", [dense])], width_in=3.5)
    assert [one.style for one in drawn] == ["line", "line", "band", "band", "line"]
    band, around, mean = drawn[2:]
    assert np.nanmedian(around.upper - mean.y) == pytest.approx(0.5**0.5, rel=0.05)
    assert np.nanmedian(mean.y - around.y) == pytest.approx(0.5**0.5, rel=0.05)
    assert (np.nanmin(band.y), np.nanmax(band.upper)) == (np.nanmin(dense.y), np.nanmax(dense.y))
    assert np.abs(mean.y[np.isfinite(mean.y)]).max() < 0.1
    assert np.isnan(mean.y[(mean.x > 41) & (mean.x < 44)]).all()
