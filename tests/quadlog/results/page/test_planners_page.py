"""The page of a comparison against its tables: every answer on the map and in the charts, with any name."""

from __future__ import annotations

import base64
import itertools
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.mapping.grid import Window
from quadlog.pipelines.comparison.compare import compare
from quadlog.pipelines.comparison.sources import CompareOptions
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.query import Query
from quadlog.results.page.planners import question_scene
from quadlog.results.studies.planners import MOST_BYTES, MOST_QUESTIONS, QuestionSample
from quadlog.results.view import Windows

OPTIONS = CompareOptions(planners=("ia_star", "mt_d_star_lite", "dijkstra"), episodes=2)
NAMES = ("astar", "ia_star", "mt_d_star_lite", "dijkstra")
HOSTILE = "<script>alert('1')</script>"


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walks through a forest."""
    folder = tmp_path_factory.mktemp("walks") / "out"
    compare(["forest:0.2"], OPTIONS, folder, False, Silent())
    return folder


@pytest.fixture(scope="module")
def queries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three queries on a map of 20 by 12 cells with a name that no page should believe; the last one has no answer."""
    folder = tmp_path_factory.mktemp("queries")
    blocked = np.zeros((12, 20), dtype=bool)
    blocked[2:, 9] = blocked[4, 4] = True
    blocked[0, 0:2] = blocked[1, 1] = True
    path = folder / HOSTILE
    path.mkdir(parents=True)
    path = path / "b&m.map"
    rows = ["".join("@" if cell else "." for cell in row) for row in blocked]
    path.write_text("\n".join(["type octile", "height 12", "width 20", "map", *rows]) + "\n")
    asked = ((0, 11, 19, 11), (2, 0, 3, 9), (0, 1, 0, 0))
    lines = ["version 1", *(f"0\tm.map\t20\t12\t{a}\t{b}\t{c}\t{d}\t0" for a, b, c, d in asked)]
    (folder / "m.scen").write_text("\n".join(lines) + "\n")
    compare([str(path)], replace(OPTIONS, scen=folder / "m.scen"), folder / "out", False, Silent())
    return folder / "out"


def drawn(page: Path) -> tuple[dict[str, Any], list[np.ndarray]]:
    """The page's drawings, and their columns as page/pack.py describes them."""
    found = re.search(r'id="page-data">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found is not None
    data = json.loads(found[1])
    raw, start, columns = np.frombuffer(zlib.decompress(base64.b64decode(data["packed"])), np.uint8), 0, []
    for length, unit, offset in data["columns"]:
        planes = raw[start : start + 4 * length].reshape(4, length).astype(np.int64)
        code = np.array([256**place for place in range(4)]) @ planes
        steps = np.where(code > 0, ((code - 1) >> 1) ^ -((code - 1) & 1), 0)
        columns.append(np.where(code > 0, np.cumsum(steps) * unit + offset, np.nan))
        start += 4 * length
    return data, columns


@pytest.mark.parametrize(("kind", "questions"), [("walks", None), ("queries", 3)])
def test_the_map_and_the_charts_have_every_answer_of_the_table(kind, questions, request):
    folder = request.getfixturevalue(kind)
    table = pq.read_table(folder / "replans.parquet").to_pandas().sort_values(["episode", "replan"], kind="stable")
    data, columns = drawn(folder / "report.html")
    assert "<script>alert" not in (folder / "report.html").read_text()
    lines = {layer["label"]: layer for layer in data["scenes"]["paths-0"]["layers"] if layer["kind"] == "lines"}
    assert list(lines) == list(NAMES)
    charts = {panel["what"]: panel["series"] for panel in data["charts"]["answers-0"]["panels"]}
    for number, name in enumerate(NAMES):
        mine, line = table[table["planner"] == name], lines[name]
        assert len(mine) == len(columns[line["t"]]) == (questions or len(mine))
        first, x, y = (columns[line[key]] for key in ("first", "x", "y"))
        for (begin, end), row in zip(itertools.pairwise(first.astype(int)), mine.itertuples(), strict=True):
            path = np.column_stack([x[begin:end], y[begin:end]])
            assert len(path) > 0 or not row.found
            if row.found:
                assert np.hypot(*np.diff(path, axis=0).T).sum() == pytest.approx(row.length_m, abs=0.01)
        for what, column in (("cells expanded", "expanded"), ("time (µs)", "us")):
            values = columns[charts[what][number]["y"]]
            wanted = mine[column].to_numpy(float)
            assert np.nan_to_num(values) == pytest.approx(
                np.nan_to_num(wanted), rel=2e-3, abs=max(0.02, 1e-4 * np.nanmax(wanted))
            )


def test_the_table_has_the_rows_of_planners_parquet_and_the_forest_plot_their_ratios(walks):
    saved = pq.read_table(walks / "planners.parquet").to_pylist()
    table = re.search(r'<table id="planners-0">.*?</table>', (walks / "report.html").read_text(), re.DOTALL)
    assert table is not None
    for text, row in zip(re.findall(r"<tr>(<th scope=\"row\".*?)</tr>", table[0], re.DOTALL), saved, strict=True):
        assert f">{row['planner']}</th>" in text.replace("<small>", "</th>")
        values = [float(value) for value in re.findall(r'data-value="([^"]*)"', text)]
        assert values[:4] == [row[key] for key in ("ratio_expanded", "us_median", "success_rate", "suboptimality_mean")]
    data, columns = drawn(walks / "report.html")
    (panel,) = data["charts"]["ratios-0"]["panels"]
    ratios = {row["planner"]: row["ratio_expanded"] for row in saved if row["planner"] != "astar"}
    assert panel["rows"] == sorted(ratios, key=ratios.__getitem__, reverse=True)
    shown = {of["label"]: columns[of["x"]].item() for of in panel["series"] if not of["variant"]}
    assert shown == pytest.approx(ratios, rel=1e-3)  # two episodes are too few for an interval


@pytest.mark.parametrize(("count", "side", "sources", "stride"), [
    (MOST_QUESTIONS, 8, 1, 1), (MOST_QUESTIONS + 1, 8, 1, 2), (MOST_QUESTIONS, 8, 4, 4), (129, 1024, 1, 4),
])  # fmt: skip
def test_every_kth_question_is_kept_with_its_own_map(count, side, sources, stride):
    """The cell (0, 0) of each map says whether its number is odd."""
    sample = QuestionSample(sources=sources)
    for name, number in itertools.product("01", range(count)):
        occupied = np.zeros((side, side), dtype=bool)
        occupied[0, 0] = number % 2
        query = Query(Window(number, 0, 0.1, occupied.shape), occupied, (0, 0), (1, 1), False, np.empty((0, 2), int))
        sample.add(number, (0, number), query, occupied, {name: np.array([[0, number % side], [1, 0]])})
    assert sample.stride == stride
    assert [shown.at[1] for shown in sample.kept.values()] == list(range(0, count, stride))
    assert all(set(shown.paths) == {"0", "1"} for shown in sample.kept.values())
    assert sum(shown.bits.nbytes for shown in sample.kept.values()) <= MOST_BYTES // sources
    scene = question_scene(sample, ["0", "1"])
    (maps,) = (layer for layer in scene.layers if isinstance(layer, Windows))
    assert maps.seconds.tolist() == list(range(1, len(sample.kept) + 1))
    for place, number in enumerate(sample.kept):
        assert maps.maps.occupied(place)[0, 0] == number % 2
        assert maps.maps.origin_m[place] == pytest.approx([0.1 * number, 0])


def test_no_wall_of_a_large_map_is_lost(tmp_path: Path) -> None:
    occupied = np.zeros((2500, 3000), dtype=bool)
    occupied[1234, :] = True
    sample = QuestionSample("query", row_zero_on_top=True)
    window = Window(0, 0, 1.0, occupied.shape)
    sample.add(0, (0, 0), Query(window, occupied, (0, 0), (2999, 0), False, np.empty((0, 2), int)), occupied, {})
    scene = question_scene(sample, [])
    (layer,) = (layer for layer in scene.layers if isinstance(layer, Windows))
    rows, columns = np.nonzero(layer.maps.occupied(0))
    assert (layer.maps.cell_m, len(columns)) == (2, 1500)
    assert set((rows * layer.maps.cell_m).tolist()) == {(2500 - 1 - 1234) // 2 * 2}  # the map's row 0 is the upper one
