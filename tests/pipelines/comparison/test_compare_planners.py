from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.errors import AlreadyExists, CannotWrite, ExitCode, RecordingNotFound, UnknownName
from quadlog.pipelines.comparison import compare as compare_planners
from quadlog.pipelines.comparison.compare import compare, failures, rule_lines
from quadlog.pipelines.comparison.problems import CompareOptions
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.registry import PLANNERS as ALL_PLANNERS
from quadlog.planning.replan import Panel
from quadlog.planning.rules import Rules
from quadlog.results.planners import PLANNERS, REPLANS, SCENARIOS

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
    for row in outcome.rows:
        mine = [
            each for each in replans.to_pylist() if (each["source"], each["planner"]) == (row["source"], row["planner"])
        ]
        assert row["replans"] == len(mine)
        assert row["episodes"] == len({each["episode"] for each in mine}) == 2
        for count in ("expanded", "generated", "touched"):
            assert row[f"{count}_total"] == sum(each[count] for each in mine)
        assert row["success_rate"] == np.mean([each["found"] for each in mine]) == 1
        assert row["length_m_total"] == pytest.approx(sum(each["length_m"] for each in mine))
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


def test_integer_costs_override_those_of_a_scen(scen):
    path, queries = scen
    options = replace(SMALL, scen=queries)
    assert options.rules.costs == "exact"
    assert replace(options, costs="integer").rules.costs == "integer"
    assert SMALL.rules.costs == "integer"
    about = compared([path], replace(options, costs="integer")).about
    assert any("costs integer" in line for line in about)


def test_no_answer_is_a_result(scen):
    outcome = compared([scen[0]], replace(SMALL, start_cell=(0, 0), goal_cell=(1, 1)))
    assert outcome.exit_code == ExitCode.DONE
    assert [row["success_rate"] for row in outcome.rows] == [0.0] * 3
    assert "nothing can be compared" in outcome.findings[0]
    assert outcome.about[-1] == "Replans without a path of astar, ia_star, mt_d_star_lite: goal blocked in 1."


def test_failures_are_told_apart_by_planner():
    columns = {
        "planner": np.array(["astar", "ea_star"] * 3),
        "found": np.array([True, False, False, False, False, False]),
        "why_not": np.array(["", "missed", "walled in", "walled in", "unreachable", "unreachable"]),
    }
    assert failures(columns) == [
        "Replans without a path of astar: unreachable in 1, walled in in 1.",
        "Replans without a path of ea_star: missed in 1, unreachable in 1, walled in in 1.",
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
    expanded = compared(["forest:0.1"], replace(options, counted="expanded"))
    ratios = [
        next(row for row in each.rows if row["planner"] == "ia_star")["ratio_expanded"] for each in (outcome, expanded)
    ]
    assert ratios[0] != ratios[1]


def test_rules_are_told_once_for_all_that_share_them():
    lines = rule_lines(["astar", "ia_star", "dijkstra"], CompareOptions())
    assert lines[1].startswith("Rules of astar, ia_star: costs integer, heuristic octile")
    assert lines[2].startswith("Rules of dijkstra: costs integer, heuristic zero")


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


def test_an_interrupted_comparison_leaves_nothing(tmp_path, monkeypatch, scen):
    ask, asked = Panel.ask, []

    def interrupted(panel, query):
        asked.append(query)
        if len(asked) == 5:  # the third planner's first query: the tables and their rows have begun
            raise KeyboardInterrupt
        return ask(panel, query)

    monkeypatch.setattr(Panel, "ask", interrupted)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(KeyboardInterrupt):
        compared([scen[0]], replace(SMALL, scen=scen[1]), tmp_path / "out")
    assert len(asked) == 5
    assert sorted(tmp_path.iterdir()) == before


def test_an_interruption_in_the_second_source_leaves_nothing_of_the_first(tmp_path, monkeypatch, scen):
    second = tmp_path / "second.map"
    second.write_text(Path(scen[0]).read_text())
    ask_everything, sources = compare_planners.ask_everything, []

    def interrupted(source, *rest, **more):
        sources.append(source)
        if len(sources) == 2:
            raise KeyboardInterrupt
        return ask_everything(source, *rest, **more)

    monkeypatch.setattr(compare_planners, "ask_everything", interrupted)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(KeyboardInterrupt):
        compared([scen[0], str(second)], replace(SMALL, scen=scen[1]), tmp_path / "out")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("place", ["taken", "taken/below"])
def test_a_file_where_the_folder_should_be(tmp_path, place):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(CannotWrite, match="taken"):
        compared(["forest:0.1"], SMALL, tmp_path / place, force=True)
    assert (tmp_path / "taken").read_text() == "a file"


def test_a_source_may_be_called_anything(tmp_path, scen):
    folder = tmp_path / "$x_{1}|a\nb #%&`<b>"
    folder.mkdir()
    path = folder / "small.map"
    path.write_text(Path(scen[0]).read_text())
    options = replace(SMALL, start_cell=(0, 0), goal_cell=(5, 3))
    compared([str(path)], options, tmp_path / "out")
    out = tmp_path / "out"
    page, tex = (out / "report.html").read_text(), (out / "planners.tex").read_text()
    assert "<b>" not in page
    bare = re.sub(r"\\begin\{tabular\}.*?\\end\{tabular\}", "", tex, flags=re.DOTALL)
    assert all(line.startswith("%") for line in bare.splitlines() if line)
    assert json.loads((out / "planners.json").read_text())[0]["source"] == str(path)
    assert (out / "plots" / "source-1-ratios.png").stat().st_size > 1000
    assert pq.read_table(out / "planners.parquet")["source"].to_pylist() == [str(path)] * 3
