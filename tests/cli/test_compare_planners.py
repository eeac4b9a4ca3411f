from __future__ import annotations

import csv
import io
import json

import pytest

from quadlog.cli import compare_planners
from quadlog.cli.main import cli, run
from quadlog.planning.registry import PLANNERS
from quadlog.planning.replan import Panel
from quadlog.results.planner_comparison.tables import FORMATS
from quadlog.results.planner_comparison.tables import PLANNERS as COLUMNS
from quadlog.simulation.worlds.scenes import MOST_PER_M2

PLAN = ["--planner", "ia_star", "--planner", "mt_d_star_lite"]
FOREST = ["compare-planners", "forest:0.1", *PLAN, "--episodes", "2"]


@pytest.fixture
def small_map(tmp_path) -> str:
    (tmp_path / "small.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n")
    return str(tmp_path / "small.map")


def one_line(capsys) -> str:
    """What an error says."""
    captured = capsys.readouterr()
    assert captured.out == ""
    said = captured.err
    assert said.count("\n") == 1, said
    assert said.startswith("quadlog: ")
    return said


def test_formats_are_those_there_are():
    """They are written down again in the command, so that its help needs no numpy."""
    assert tuple(FORMATS) == compare_planners.FORMATS


def test_help_names_sources_and_options(capsys):
    assert run(["compare-planners", "--help"]) == 0
    out = capsys.readouterr().out
    for word in ("run folder", "recording", ".map", ".yaml", "forest:DENSITY", "--scen", *PLANNERS):
        assert word in out
    assert cli.get_command(None, "compare-planners").help


def test_json_is_a_list_of_flat_objects_and_all_there_is_on_stdout(capsys):
    assert run([*FOREST, "--format", "json"]) == 0
    captured = capsys.readouterr()
    rows = json.loads(captured.out)
    assert [row["planner"] for row in rows] == ["astar", "ia_star", "mt_d_star_lite"]
    for row in rows:
        assert list(row) == [name for name in COLUMNS.names if name in row]
        assert isinstance(row.pop("source"), str)
        assert isinstance(row.pop("planner"), str)
        assert all(type(value) in (int, float) for value in row.values())
        assert {name for name in row if type(row[name]) is int} == {
            "episodes",
            "replans",
            *(f"{count}_total" for count in ("expanded", "generated", "touched")),
        }
    assert "fallback_share" not in rows[0]
    assert "fallback_share" in rows[1]
    assert "Rules of astar" in captured.err
    assert "saved most" in captured.err


def test_csv_is_the_same_rows(small_map, capsys):
    arguments = ["compare-planners", small_map, *PLAN, "--start-cell", "0,0", "--goal-cell", "3,2"]
    assert run([*arguments, "--format", "json"]) == 0
    flat = json.loads(capsys.readouterr().out)
    assert run([*arguments, "--format", "csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert list(rows[0]) == COLUMNS.names
    for row, expected in zip(rows, flat, strict=True):
        for name in set(COLUMNS.names) - {"us_median", "us_p95"}:
            assert row[name] == str(expected.get(name, "")), name


@pytest.mark.parametrize(
    ("to", "holds"), [("table", "forest:0.1: 2 episodes"), ("markdown", "| ia\\_star | 100 |"), ("latex", "\\toprule")]
)
def test_what_people_read_says_how_to_read_it(capsys, to, holds):
    assert run([*FOREST, "--format", to]) == 0
    captured = capsys.readouterr()
    assert holds in captured.out
    assert "solved by all 3 planners: ratio, excess cost" in captured.out
    assert "fewer than 6 episodes are too few" in captured.out
    assert captured.err == ""


def test_nothing_is_written_without_a_folder(tmp_path, small_map, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    arguments = ["compare-planners", "small.map", *PLAN, "--start-cell", "0,0", "--goal-cell", "3,2"]
    assert run(arguments) == 0
    assert sorted(tmp_path.iterdir()) == before
    assert run([*arguments, "-o", "out"]) == 0
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*") if path.is_file()}
    capsys.readouterr()
    assert run([*arguments, "-o", "out"]) == 1
    assert "out/README.md exists: use --force to replace it" in one_line(capsys)
    assert {path: path.stat().st_mtime_ns for path in written} == written
    assert run([*arguments, "-o", "out", "--force"]) == 0


def test_no_way_is_no_error(small_map, capsys):
    arguments = ["--start-cell", "0,0", "--goal-cell", "1,1", "--format", "json"]
    assert run(["compare-planners", small_map, *PLAN, *arguments]) == 0
    captured = capsys.readouterr()
    assert [row["success_rate"] for row in json.loads(captured.out)] == [0.0] * 3
    assert "Replans without a path of astar, ia_star, mt_d_star_lite: goal blocked in 1." in captured.err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["forest:-1"], 2, f"forest:-1: trees per m² between 0 and {MOST_PER_M2:g}, as in  forest:0.2"),
        (["forest:abc"], 2, "forest:abc"),
        (["forest:nan"], 2, "forest:nan"),
        (["forest:0.1", "--scen", "a.scen"], 2, "--scen FILE.scen is for MovingAI .map files"),
        (["forest:0.1", "--start-cell", "1,1"], 2, "--start-cell and --goal-cell go together"),
        (["nowhere.map", "--start-cell", "1,1", "--goal-cell", "1,1"], 1, "nowhere.map: No such file or directory"),
        (["nowhere.yaml", "--start-cell", "1,1", "--goal-cell", "1,1"], 1, "nowhere.yaml: No such file or directory"),
        (["nowhere"], 1, "nowhere: no such file or folder"),
        (["nowhere.bag", "--set", "grid.dilatoin_m=1"], 1, "did you mean grid.dilation_m"),
        (["nowhere.map"], 1, "nowhere.map: No such file or directory"),
        (["forest:0.1", "-o", "/dev/null"], 1, "/dev/null: cannot be written"),
    ],
)
def test_mistakes_are_one_line(capsys, arguments, code, says):
    assert run(["compare-planners", *arguments]) == code
    assert says in one_line(capsys)


def test_a_map_needs_a_query(small_map, capsys):
    assert run(["compare-planners", small_map]) == 2
    assert "Give --start-cell COL,ROW and --goal-cell COL,ROW or --scen FILE.scen" in one_line(capsys)
    assert run(["compare-planners", small_map, "--start-cell", "0,0", "--goal-cell", "4,0"]) == 2
    assert "--goal-cell 4,0 lies outside" in one_line(capsys)


@pytest.mark.parametrize("cell", ["1", "1,2,3", "a,b", "-1,0", "--1,0", "1,9999999999", "1.5,2", "", "٣,1"])
def test_a_cell_is_two_whole_numbers(small_map, capsys, cell):
    assert run(["compare-planners", small_map, "--start-cell", cell, "--goal-cell", "0,0"]) == 2
    assert "is not two whole numbers of 0 or more, as in 12,34" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option", [["--planner", "a_star"], ["--preset", "papers"], ["--episodes", "0"], ["--seed", "x"]]
)
def test_an_unknown_choice_is_usage(capsys, option):
    assert run(["compare-planners", "forest:0.1", *option]) == 2
    assert option[0] in capsys.readouterr().err


def test_no_source_is_usage():
    assert run(["compare-planners"]) == 2


def test_interrupted(tmp_path, monkeypatch, capsys):
    def interrupted(panel, query):
        raise KeyboardInterrupt

    monkeypatch.setattr(Panel, "ask", interrupted)
    assert run([*FOREST, "-o", str(tmp_path / "out")]) == 1
    assert "nothing half-written was left" in one_line(capsys)
    assert list(tmp_path.iterdir()) == []
