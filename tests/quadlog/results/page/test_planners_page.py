"""The page of a comparison against its tables: every answer in the charts, with any name."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from quadlog.errors import NotARun
from quadlog.pipelines.comparison.compare import compare
from quadlog.pipelines.comparison.sources import CompareOptions
from quadlog.pipelines.executor.progress import Silent
from quadlog.results.studies.planners import format_rows, saved_figures

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
def test_the_charts_have_every_answer_of_the_table(kind, questions, request):
    folder = request.getfixturevalue(kind)
    table = pq.read_table(folder / "replans.parquet").to_pandas().sort_values(["episode", "replan"], kind="stable")
    data, columns = drawn(folder / "report.html")
    assert "<script>alert" not in (folder / "report.html").read_text()
    charts = {panel["what"]: panel["series"] for panel in data["charts"]["replans-0"]["panels"]}
    for number, name in enumerate(NAMES):
        mine = table[table["planner"] == name]
        assert len(mine) == (questions or len(mine)) > 1
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


def test_saved_figures_say_what_the_ratios_count_and_compare_with(tmp_path):
    options = CompareOptions(planners=("ia_star",), preset="paper", episodes=1)
    outcome = compare(["forest:0.2"], options, tmp_path, False, Silent())

    def said() -> list[str]:
        figures = saved_figures(tmp_path)
        return [figures[f"source-1-{name}"][0].what for name in ("ratios", "replans")]

    assert said() == ["times fewer cells generated than astar_paper", "cells generated"]
    assert "ratio: cells generated by astar_paper" in " ".join(format_rows(outcome.rows, "table").split())
    path = tmp_path / "planners.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["baseline", "counted"]), path)  # as older tables are
    assert said() == ["times fewer cells expanded than astar_paper", "cells expanded"]
    for name, column in (("planners", "us_p95"), ("replans", "expanded")):
        whole = pq.read_table(tmp_path / f"{name}.parquet")
        odd = whole.set_column(whole.column_names.index(column), column, pa.array(["?"] * len(whole)))
        for damaged in (whole.drop_columns([column]), odd):
            pq.write_table(damaged, tmp_path / f"{name}.parquet")
            with pytest.raises(NotARun, match=rf"{name}\.parquet.*no column {column}"):
                saved_figures(tmp_path)
        pq.write_table(whole, tmp_path / f"{name}.parquet")
