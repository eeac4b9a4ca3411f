from __future__ import annotations

import json

import pytest

from quadlog.results.studies.planners import PLANNERS

PLAN = ["--planner", "ia_star", "--planner", "mt_d_star_lite"]
FOREST = ["compare-planners", "forest:0.1", *PLAN, "--episodes", "2"]


@pytest.fixture
def small_map(tmp_path) -> str:
    (tmp_path / "small.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n")
    return str(tmp_path / "small.map")


def test_json_is_a_list_of_flat_objects_and_all_there_is_on_stdout(quadlog, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = quadlog(*FOREST, "--format", "json")
    assert not list(tmp_path.iterdir()), "nothing is written without -o"
    rows = json.loads(done.out)
    assert [row["planner"] for row in rows] == ["astar", "ia_star", "mt_d_star_lite"]
    totals = {f"{count}_total" for count in ("expanded", "generated", "touched")}
    for row in rows:
        assert list(row) == [name for name in PLANNERS.names if name in row]
        assert {name for name in row if type(row[name]) is int} == {"episodes", "replans", *totals}
        assert {name for name in row if type(row[name]) is str} == {"source", "planner", "baseline", "counted"}
        assert {type(value) for value in row.values()} == {int, float, str}
    assert ["fallback_share" in row for row in rows] == [False, True, True]
    assert "Rules of astar" in done.err
    assert "saved most" in done.err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["forest:-1"], 2, "forest:-1: trees per m² between 0 and"),
        (["forest:0.1", "--scen", "a.scen"], 2, "--scen FILE.scen is for MovingAI .map files"),
        (["nowhere.yaml", "--start-cell", "1,1", "--goal-cell", "1,1"], 1, "nowhere.yaml: No such file"),
        (["MAP"], 2, "Give --start-cell COL,ROW and --goal-cell COL,ROW or --scen FILE.scen"),
        (["MAP", "--start-cell", "0,0", "--goal-cell", "4,0"], 2, "--goal-cell 4,0 lies outside"),
    ],
)
def test_mistakes_are_named(refused, small_map, arguments, code, says):
    assert says in refused(code, "compare-planners", *(small_map if word == "MAP" else word for word in arguments))
