"""report.html of a comparison against its tables: every number, every path, and names that could be anything."""

from __future__ import annotations

import base64
import html
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

from quadlog.pipelines.comparison.compare import compare
from quadlog.pipelines.comparison.problems import CompareOptions
from quadlog.pipelines.executor.progress import Silent
from quadlog.results.planner_comparison import folder as comparison_folder

OPTIONS = CompareOptions(planners=("ia_star", "mt_d_star_lite", "dijkstra"), episodes=2)
NAMES = ("astar", "ia_star", "mt_d_star_lite", "dijkstra")


@pytest.fixture(scope="module", autouse=True)
def _no_pictures():
    """What they show is tested elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison_folder, "render_png", lambda draw: draw.func.__name__.encode())
        yield


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walks through a forest."""
    folder = tmp_path_factory.mktemp("walks") / "out"
    compare(["forest:0.2"], OPTIONS, folder, False, Silent())
    return folder


@pytest.fixture
def queries(tmp_path: Path) -> Path:
    """Three queries on a map of 20 by 12 cells with a name that no page should believe; the last one has no answer."""
    blocked = np.zeros((12, 20), dtype=bool)
    blocked[2:, 9] = blocked[4, 4] = True
    blocked[0, 0:2] = blocked[1, 1] = True
    path = tmp_path / "<script>alert('1')</script>"
    path.mkdir(parents=True)
    path = path / "b&m.map"
    rows = ["".join("@" if cell else "." for cell in row) for row in blocked]
    path.write_text("\n".join(["type octile", "height 12", "width 20", "map", *rows]) + "\n")
    asked = ((0, 11, 19, 11), (2, 0, 3, 9), (0, 1, 0, 0))
    lines = ["version 1", *(f"0\tm.map\t20\t12\t{a}\t{b}\t{c}\t{d}\t0" for a, b, c, d in asked)]
    scen = tmp_path / "m.scen"
    scen.write_text("\n".join(lines) + "\n")
    compare([str(path)], replace(OPTIONS, scen=scen), tmp_path / "out", False, Silent())
    return tmp_path / "out"


def script(page: Path, name: str) -> Any:
    found = re.search(rf'id="{name}">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def unpacked(block: dict[str, Any]) -> list[np.ndarray]:
    """Columns of a packed block, as its docstring describes them."""
    raw = np.frombuffer(zlib.decompress(base64.b64decode(block["packed"])), np.uint8)
    columns, start = [], 0
    for length in block["lengths"]:
        planes = raw[start : start + 4 * length].reshape(4, length).astype(np.int64)
        code = sum(plane << (8 * at) for at, plane in enumerate(planes))
        columns.append(np.cumsum((code >> 1) ^ -(code & 1)))
        start += 4 * length
    return columns


def shown_answers(page: Path) -> list[dict[str, Any]]:
    """What the map shows of each question and planner."""
    data = script(page, "map-data")["1"]
    columns = unpacked(data["answers"])
    found = []
    for planner, route in zip(data["planners"], data["routes"], strict=True):
        taken = {name: columns[at] for name, at in route.items()}
        for at, (begin, end) in enumerate(itertools.pairwise(taken["first"])):
            path = np.column_stack([taken["x"][begin:end], taken["y"][begin:end]])
            places = {name: int(columns[data[name]][at]) - 1 for name in ("episode", "replan")}
            numbers = {name: int(taken[name][at]) for name in ("cells", "us", "cost", "found")}
            found.append({"planner": planner["name"], "path": path, "cell": data["edge"], **places, **numbers})
    return found


@pytest.mark.parametrize("kind", ["walks", "queries"])
def test_the_map_has_every_answer_of_the_table(kind, request):
    folder = request.getfixturevalue(kind)
    rows = pq.read_table(folder / "replans.parquet").to_pylist()
    table = {(row["planner"], row["episode"], row["replan"]): row for row in rows}
    shown = shown_answers(folder / "report.html")
    assert len(shown) == len(table)
    for each in shown:
        row = table[each["planner"], each["episode"], each["replan"]]
        assert each["cells"] == row["expanded"]
        assert each["us"] == pytest.approx(10 * row["us"], abs=0.51)
        assert bool(each["found"]) == row["found"]
        if not row["found"]:
            assert each["cost"] == -1
            assert len(each["path"]) == 0
            continue
        assert each["cost"] == pytest.approx(100 * row["cost"], abs=0.51)
        length = np.hypot(*np.diff(each["path"], axis=0).T).sum() * each["cell"]
        assert length == pytest.approx(row["length_m"], abs=1e-6)
        if kind == "walks":
            away = [row["goal_col"] - row["start_col"], row["goal_row"] - row["start_row"]]
        else:  # rows of such a map count from its top
            away = [row["goal_col"] - row["start_col"], row["start_row"] - row["goal_row"]]
        assert (each["path"][-1] - each["path"][0]).tolist() == away


@pytest.mark.parametrize("kind", ["walks", "queries"])
def test_the_charts_have_cells_and_times_of_the_table(kind, request):
    folder = request.getfixturevalue(kind)
    table = pq.read_table(folder / "replans.parquet").to_pandas()
    panels = script(folder / "report.html", "chart-data")["replans-1"]["panels"]
    assert [panel["what"].split(" per ")[0] for panel in panels] == ["cells expanded", "time"]
    for panel, column in zip(panels, ("expanded", "us"), strict=True):
        assert [line["label"] for line in panel["lines"]] == list(NAMES)
        at = np.array(panel["seconds"], dtype=int) - 1
        for name, values in zip(NAMES, panel["values"], strict=True):
            mine = table[table.planner == name].sort_values(["episode", "replan"])[column].to_numpy()
            assert np.asarray(values) == pytest.approx(mine[at], rel=1e-3, abs=0.1)
            assert {mine.min(), mine.max()} <= set(mine[at])


def test_the_tables_rows_are_those_of_planners_parquet(walks):
    page = (walks / "report.html").read_text()
    rows = re.findall(r'<tr><th scope="row"><span class="hue[^>]*>(.*?)</tr>', page)
    saved = pq.read_table(walks / "planners.parquet").to_pylist()
    for text, row in zip(rows, saved, strict=True):
        assert text.startswith(row["planner"])
        numbers = [float(value) for value in re.findall(r'<data value="([^"]*)">', text)]
        assert numbers == [row[name] for name in ("success_rate", "expanded_total", "ratio_expanded", "us_median")]
    # Two walks are too few for an interval, whatever the numbers are.
    assert page.count("too few to tell") == len(NAMES) - 1


def test_the_verdict_is_on_top_and_never_says_both(walks):
    page = html.unescape((walks / "report.html").read_text())
    top = page[: page.index("<main>")]
    assert re.search(r"<dt>Cells</dt><dd>mt_d_star_lite saved most: [\d.]+ times fewer cells expanded than astar", top)
    assert "<dt>Time</dt>" in top
    assert "2 episodes, " in top
    body = page[: page.index('<script type="application/json"')]
    assert ("fastest" in body) + ("do not show which planner is quickest" in body) == 1
    assert len((walks / "report.html").read_bytes()) < 6_000_000


def test_names_are_text(queries):
    page = (queries / "report.html").read_text()
    assert "<script>alert" not in page
    assert "b&amp;m.map" in page
    assert "Content-Security-Policy" in page
    assert "no path" not in page.split("<main>")[0]


def test_a_second_run_gives_the_same_page_but_for_the_times(tmp_path, monkeypatch):
    def clock() -> int:
        return next(ticks)

    monkeypatch.setattr("quadlog.planning.replan.time.perf_counter_ns", clock)
    pages = []
    for name in ("one", "two"):
        ticks = itertools.count(0, 1000)
        compare(["forest:0.1"], replace(OPTIONS, planners=("ia_star",), episodes=1), tmp_path / name, False, Silent())
        pages.append((tmp_path / name / "report.html").read_bytes())
    assert pages[0] == pages[1]


def test_what_was_lost_stands_on_the_page(tmp_path, monkeypatch):
    from quadlog.pipelines.comparison import compare as module

    opened = module.open_sources
    monkeypatch.setattr(module, "open_sources", lambda *all_of: (opened(*all_of)[0], ["walk.mcap: <1> chunk damaged"]))
    compare(["forest:0.1"], replace(OPTIONS, planners=("ia_star",), episodes=1), tmp_path / "out", False, Silent())
    assert "walk.mcap: &lt;1&gt; chunk damaged" in (tmp_path / "out" / "report.html").read_text()
