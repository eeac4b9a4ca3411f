from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.errors import AlreadyExists, CannotWrite, ExitCode, RecordingNotFound, UnknownName, UsageError
from quadlog.pipelines.comparison.compare import compare, failures
from quadlog.pipelines.comparison.sources import CompareOptions, open_sources
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.registry import PLANNERS as ALL_PLANNERS
from quadlog.planning.rules import Rules
from quadlog.results.page import planners as page
from quadlog.results.studies.planners import PLANNERS, REPLANS, SCENARIOS
from quadlog.storage.atomic_write import complete_folders

SMALL = CompareOptions(planners=("ia_star", "mt_d_star_lite"), episodes=2)
# Figures that the clock decides.
TIMED = {"us", "us_median", "us_p95"}


def compared(arguments: Sequence[str], options: CompareOptions, folder: Path | None = None, force: bool = False):
    return compare(arguments, options, folder, force, Silent())


def untimed(path: Path) -> dict[str, bytes]:
    """The content of a table's columns, those of the clock left out."""
    table = pq.read_table(path)
    return {name: repr(table[name].to_pylist()).encode() for name in table.column_names if name not in TIMED}


@pytest.fixture
def scen(tmp_path) -> tuple[str, Path]:
    """A map of 6 by 4 cells with two queries, of which the second starts in a wall."""
    (tmp_path / "small.map").write_text("type octile\nheight 4\nwidth 6\nmap\n......\n.@@@@.\n.@.@@.\n......\n")
    lines = ["version 1", "0\tsmall.map\t6\t4\t0\t0\t5\t3\t8", "0\tsmall.map\t6\t4\t1\t1\t5\t3\t6"]
    (tmp_path / "small.map.scen").write_text("\n".join(lines) + "\n")
    return str(tmp_path / "small.map"), tmp_path / "small.map.scen"


def test_a_folder_holds_tables_texts_and_plots(tmp_path):
    folder = tmp_path / "new" / "out"
    outcome = compared(["forest:0.1", "forest:0.2"], SMALL, folder)
    assert outcome.exit_code == ExitCode.DONE
    texts = {"report.html", *(f"planners.{suffix}" for suffix in ("csv", "json", "tex"))}
    assert {path.name for path in folder.iterdir()} == texts | {"planners.parquet", "plots", "replans.parquet"}
    assert sorted(path.name for path in (folder / "plots").iterdir()) == [
        f"source-{number}-ratios.png" for number in (1, 2)
    ]
    assert pq.read_schema(folder / "planners.parquet").equals(PLANNERS)
    assert pq.read_schema(folder / "replans.parquet").equals(REPLANS)
    planners, replans = (pq.read_table(folder / f"{name}.parquet") for name in ("planners", "replans"))
    names = ["astar", "ia_star", "mt_d_star_lite"]
    assert planners["planner"].to_pylist() == names * 2
    assert planners["source"].to_pylist() == ["forest:0.1"] * 3 + ["forest:0.2"] * 3
    assert planners.to_pylist() == outcome.rows
    assert sum(planners["replans"].to_pylist()) == replans.num_rows
    table = replans.to_pandas()
    for row in outcome.rows:
        mine = table[(table["source"] == row["source"]) & (table["planner"] == row["planner"])]
        assert (row["replans"], row["episodes"], row["success_rate"]) == (len(mine), 2, mine["found"].mean())
        for count in ("expanded", "generated", "touched"):
            assert row[f"{count}_total"] == mine[count].sum()
        assert row["length_m_total"] == pytest.approx(mine["length_m"].sum())
    assert len(outcome.findings) == 2
    shown = json.loads((folder / "planners.json").read_text())
    assert [each["expanded_total"] for each in shown] == planners["expanded_total"].to_pylist()


def test_same_seed_same_bytes_and_another_seed_another_forest(tmp_path):
    options = replace(SMALL, seed=4, episodes=1)
    rows = [compared(["forest:0.2"], options, tmp_path / name).rows for name in ("one", "two")]
    for table in ("replans.parquet", "planners.parquet"):
        assert untimed(tmp_path / "one" / table) == untimed(tmp_path / "two" / table)
    other = compared(["forest:0.2"], replace(options, seed=5)).rows
    assert [row["expanded_total"] for row in rows[0]] != [row["expanded_total"] for row in other]


def test_a_scen_gives_scenarios(scen, tmp_path):
    path, queries = scen
    outcome = compared([path], replace(SMALL, scen=queries), tmp_path / "out")
    table = pq.read_table(tmp_path / "out" / "scenarios.parquet")
    assert table.schema.equals(SCENARIOS)
    rows = table.to_pylist()
    assert [(row["planner"], row["found"]) for row in rows] == [
        (name, found) for name in ("astar", "ia_star", "mt_d_star_lite") for found in (True, False)
    ]
    assert [(row["listed_cost"], row["cost"]) for row in rows] == [(8.0, 8.0), (6.0, None)] * 3
    assert {(row["map"], row["start_col"], row["start_row"], row["goal_col"], row["goal_row"]) for row in rows} == {
        (path, 0, 0, 5, 3),
        (path, 1, 1, 5, 3),
    }
    assert [row["success_rate"] for row in outcome.rows] == [0.5] * 3
    assert "Replans without a path of astar, ia_star, mt_d_star_lite: start blocked in 1." in outcome.about
    assert any("costs exact" in line for line in outcome.about)


def test_failures_are_told_apart_by_planner():
    columns = {
        "planner": np.array(["astar", "ea_star"] * 2),
        "found": np.array([True, False, False, False]),
        "why_not": np.array(["", "missed", "walled in", "walled in"]),
    }
    assert failures(columns) == [
        "Replans without a path of astar: walled in in 1.",
        "Replans without a path of ea_star: missed in 1, walled in in 1.",
    ]


def test_the_baseline_always_runs_and_comes_first():
    assert CompareOptions(planners=("ia_star", "astar", "ia_star")).names == ("astar", "ia_star")
    assert CompareOptions(planners=("ia_star",), preset="paper").names == ("astar_paper", "ia_star")
    assert CompareOptions().names == tuple(ALL_PLANNERS)
    assert set(CompareOptions(preset="paper").names) == set(ALL_PLANNERS)
    for wrong in (CompareOptions(planners=("a_star",)), CompareOptions(leader="nobody")):
        with pytest.raises(UnknownName, match="ia_star_bounded"):
            _ = (wrong.names, wrong.walked_by)


def test_the_papers_preset_counts_generated_cells_and_says_so():
    options = CompareOptions(planners=("ia_star",), preset="paper", episodes=1)
    assert options.rules == Rules(heuristic="manhattan")
    outcome = compared(["forest:0.1"], options)
    rows = {row["planner"]: row for row in outcome.rows}
    assert rows["astar_paper"]["ratio_expanded"] == 1
    assert "Preset paper, counting generated cells, seed 0." in outcome.about
    assert any("led by ia_star" in line and "(square)" in line for line in outcome.about)


def test_an_earlier_comparison_is_kept_unless_forced_and_until_the_new_one_is_whole(tmp_path, scen):
    folder = tmp_path / "out"
    compared([scen[0]], replace(SMALL, scen=scen[1]), folder)
    (folder / "notes.txt").write_text("mine")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(AlreadyExists, match=r"report\.html exists: use --force to replace it"):
        compared(["forest:0.1"], SMALL, folder)
    with pytest.raises(RecordingNotFound):
        compared(["forest:0.1", str(tmp_path / "nothing")], SMALL, folder, force=True)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    compared(["forest:0.1"], replace(SMALL, episodes=1), folder, force=True)
    assert not (folder / "scenarios.parquet").exists()
    assert (folder / "notes.txt").read_text() == "mine"
    assert "forest:0.1" in (folder / "report.html").read_text()


@pytest.mark.parametrize("in_the_way", ["taken", "taken/plots"])
def test_a_file_where_a_folder_should_be(tmp_path, scen, in_the_way):
    (tmp_path / in_the_way).parent.mkdir(exist_ok=True)
    (tmp_path / in_the_way).write_text("a file")
    with pytest.raises(CannotWrite, match="taken"):
        compared([scen[0]], replace(SMALL, scen=scen[1]), tmp_path / "taken", force=True)
    assert (tmp_path / in_the_way).read_text() == "a file"
    assert not list(tmp_path.glob("taken/*.parquet"))


def test_a_signal_while_the_files_appear_comes_when_all_are_there(tmp_path, monkeypatch, scen):
    """The last chance to stop a comparison is before its first file appears."""

    def raises(number: int, _: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, raises)
    write_whole, writes = page.write_whole, []

    def write(path, content):
        writes.append(path)
        signal.raise_signal(signal.SIGTERM)
        write_whole(path, content)

    monkeypatch.setattr(page, "write_whole", write)
    try:
        with pytest.raises(KeyboardInterrupt):
            compared([scen[0]], replace(SMALL, scen=scen[1]), tmp_path / "out")
    finally:
        signal.signal(signal.SIGTERM, before)
    assert len(writes) > 3
    assert writes[-1].name == "report.html"
    assert all(path.is_file() for path in writes)
    assert complete_folders(0.0)[-1] == tmp_path / "out"


def test_each_source_is_opened_once_by_what_it_is_called(planned_run, tmp_path):
    arguments = [str(planned_run), "forest:0.1", "forest:0.1"]
    sources, losses = open_sources(arguments, CompareOptions(episodes=3), tmp_path, Silent())
    assert [(each.name, each.count, each.is_static) for each in sources] == [
        (str(planned_run), 1, False), ("forest:0.1", 3, False)
    ]  # fmt: skip
    assert losses == []
    with pytest.raises(RecordingNotFound, match="no recording in this folder"):
        open_sources([str(tmp_path)], CompareOptions(), tmp_path, Silent())


@pytest.mark.parametrize(
    ("arguments", "options", "says"),
    [
        (["forest:0.1"], {"start_cell": (0, 0), "goal_cell": (1, 1)}, "are for MovingAI .map and ROS map_server .yaml"),
        (["a.map", "a.yaml"], {"scen": "a.scen"}, "--scen FILE.scen is for MovingAI .map files"),
        (["a.map"], {"scen": "a.scen", "start_cell": (0, 0), "goal_cell": (1, 1)}, "of its own"),
        (["forest:2.01"], {}, r"trees per m² between 0 and 2, as in  forest:0\.2"),
    ],
)
def test_queries_that_no_source_takes_are_usage(tmp_path, arguments, options, says):
    with pytest.raises(UsageError, match=says):
        open_sources(arguments, CompareOptions(**options), tmp_path, Silent())
