"""Planners compared: what each source asks, that costs are the true ones, and what a folder of a comparison holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadlog.config.file import load_config
from quadlog.errors import ExitCode, MissingInput
from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.pipelines.comparison.compare import CompareOutcome, ask_everything, compare, scenarios_of
from quadlog.pipelines.comparison.sources import (
    CompareOptions,
    ProblemSource,
    Question,
    forest_source,
    movingai_source,
    recording_source,
    ros_map_source,
    run_source,
)
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOutcome
from quadlog.planning import registry
from quadlog.planning.planners.astar import AStar
from quadlog.planning.protocol import no_plan
from quadlog.planning.query import Growth, NoQuery
from quadlog.planning.rules import Rules
from quadlog.results.arrays import load_maps
from quadlog.results.studies.planners import PLANNERS, REPLANS, SCENARIOS
from quadlog.results.tables import read_table
from quadlog.storage.formats.ros_map import write_rosmap
from tests.pipelines.conftest import FIXTURES, cut, fixture_request


@pytest.fixture(scope="session")
def planned_run(once: Callable[..., ReplayOutcome]) -> Path:
    """A run folder up to its stage `plan`; not to be changed."""

    def make(runs: Path) -> ReplayOutcome:
        return replay(replace(fixture_request(runs / "follow", duration_s=1.0, until="plan"), plots=False), Silent())

    return once("planned", make).run


@pytest.fixture
def static(tmp_path: Path) -> Callable[..., ProblemSource]:
    """A source of a MovingAI map of blocked (rows, cols), or of its lines; queries: (start, goal, length), or ends."""

    def make(blocked: np.ndarray | list[str], queries: Any) -> ProblemSource:
        if isinstance(blocked, np.ndarray):
            blocked = ["".join("@" if cell else "." for cell in row) for row in blocked]
        rows, cols = len(blocked), len(blocked[0])
        lines = ["type octile", f"height {rows}", f"width {cols}", "map", *blocked]
        (tmp_path / "small.map").write_text("\n".join(lines) + "\n")
        if isinstance(queries, tuple):
            return movingai_source(tmp_path / "small.map", "small.map", None, queries)
        lines = [
            f"0\tsmall.map\t{cols}\t{rows}\t{start[0]}\t{start[1]}\t{goal[0]}\t{goal[1]}\t{length}"
            for start, goal, length in queries
        ]
        (tmp_path / "small.map.scen").write_text("\n".join(["version 1", *lines]) + "\n")
        return movingai_source(tmp_path / "small.map", "small.map", tmp_path / "small.map.scen", None)

    return make


NAMES = ["astar", "clearance_astar", "ia_star"]


class Steps(Silent):
    count = 0

    def advance(self, recorded_s: float | None = None) -> None:
        self.count += 1


@pytest.mark.parametrize("kind", ["static", "walk"])
def test_every_planner_answers_every_question_and_repeats_change_times_alone(static, kind):
    source = forest_source("forest:0.1", 2, "astar", Rules(), "euclidean", 3)
    if kind == "static":
        blocked = np.zeros((20, 20), dtype=bool)
        blocked[3:18, 9] = True
        source = static(blocked, [((0, 0), (2, 0), 2), ((6, 10), (12, 10), 0), ((0, 0), (6, 1), 6.4)])
    progress = Steps()
    columns = ask_everything(source, NAMES, Rules(), progress)
    assert (list(columns), progress.count) == ([*REPLANS.names, "us_repeats"], source.count)
    for name in NAMES:
        mine = columns["planner"] == name
        for each in ("episode", "replan", "t_ns", "start_col", "goal_row"):
            assert_array_equal(columns[each][mine], columns[each][columns["planner"] == "astar"], each)
    scenarios = scenarios_of(source, columns)
    assert scenarios is None if kind == "walk" else sorted(scenarios) == sorted(SCENARIOS.names)
    own = columns["planner"] == "astar"
    assert_array_equal(columns["optimal_cost"][own], columns["cost"][own])
    often = ask_everything(source, NAMES, Rules(), Silent(), 4)
    for name in set(REPLANS.names) - {"us"}:
        assert_array_equal(columns[name], often[name], name)
    assert_array_equal(np.median(often["us_repeats"], axis=1), often["us"])


def test_why_there_is_no_path_and_how_long_one_is(static, monkeypatch):
    """Missed: there is one that others found. Two steps right, a diagonal, one up: two turns of an eighth."""

    class Blind(AStar):
        def plan(self, *asked):
            return no_plan()

    monkeypatch.setitem(registry.PLANNERS, "blind", Blind)
    ways = static(["....", "@@..", "@@@."], [((0, 0), (3, 2), 0), ((0, 0), (0, 2), 0)])
    asked = [question for episode in ways.episodes() for question in episode]
    source = ProblemSource("walk", "", lambda: iter([[*asked, Question(9, NoQuery("walled in"))]]), 1)
    columns = ask_everything(source, ["astar", "blind"], Rules(), Silent())
    assert columns["why_not"].tolist() == ["", "missed", "goal blocked", "goal blocked", "walled in", "walled in"]
    assert_allclose(columns["length_m"], [3 + math.sqrt(2), *[math.nan] * 5])
    assert_allclose(columns["turn_rad"], [math.pi / 2, *[math.nan] * 5])
    assert_array_equal(columns["optimal_cost"], [44, 44, *[math.nan] * 4])
    assert np.isnan(columns["us"][-2:]).all()


SMALL = CompareOptions(planners=("ia_star", "mt_d_star_lite"), episodes=2)


def compared(arguments: Sequence[str], options: CompareOptions, folder: Path | None = None) -> CompareOutcome:
    return compare(arguments, options, folder, False, Silent())


def test_a_folder_holds_tables_and_a_page_that_say_the_same(tmp_path):
    folder = tmp_path / "new" / "out"
    outcome = compared(["forest:0.1", "forest:0.2"], SMALL, folder)
    assert (outcome.exit_code, len(outcome.findings)) == (ExitCode.DONE, 2)
    assert {path.name for path in folder.iterdir()} == {"report.html", "planners.parquet", "replans.parquet"}
    planners, replans = (pq.read_table(folder / f"{name}.parquet") for name in ("planners", "replans"))
    assert (planners.schema.equals(PLANNERS), replans.schema.equals(REPLANS)) == (True, True)
    assert planners["planner"].to_pylist() == ["astar", "ia_star", "mt_d_star_lite"] * 2  # the baseline always runs
    assert planners.to_pylist() == outcome.rows
    table = replans.to_pandas()
    for row in outcome.rows:
        mine = table[(table["source"] == row["source"]) & (table["planner"] == row["planner"])]
        assert (row["replans"], row["episodes"], row["success_rate"]) == (len(mine), 2, mine["found"].mean())
        for count in ("expanded", "generated", "touched"):
            assert row[f"{count}_total"] == mine[count].sum()
        assert row["length_m_total"] == pytest.approx(mine["length_m"].sum())


def untimed(path: Path) -> dict[str, list[Any]]:
    """The columns of a table but for those that the clock decides."""
    return pq.read_table(path).drop_columns({"us", "us_median", "us_p95"} & set(pq.read_schema(path).names)).to_pydict()


def test_same_seed_same_results_and_another_seed_another_forest(tmp_path):
    options = replace(SMALL, seed=4, episodes=1)
    rows = [compared(["forest:0.2"], options, tmp_path / name).rows for name in ("one", "two")]
    for table in ("replans.parquet", "planners.parquet"):
        assert repr(untimed(tmp_path / "one" / table)) == repr(untimed(tmp_path / "two" / table))
    other = compared(["forest:0.2"], replace(options, seed=5)).rows
    assert [row["expanded_total"] for row in rows[0]] != [row["expanded_total"] for row in other]


def test_a_scen_gives_scenarios_and_why_there_is_no_path(static, tmp_path):
    """The second query starts in a wall."""
    static(["......", ".@@@@.", ".@.@@.", "......"], [((0, 0), (5, 3), 8), ((1, 1), (5, 3), 6)])
    options = replace(SMALL, scen=tmp_path / "small.map.scen")
    outcome = compared([str(tmp_path / "small.map")], options, tmp_path / "out")
    table = pq.read_table(tmp_path / "out" / "scenarios.parquet")
    assert table.schema.equals(SCENARIOS)
    found = [(row["planner"], row["found"], row["listed_cost"], row["cost"]) for row in table.to_pylist()]
    names = ("astar", "ia_star", "mt_d_star_lite")
    assert found == [(name, *row) for name in names for row in ((True, 8.0, 8.0), (False, 6.0, None))]
    assert [row["success_rate"] for row in outcome.rows] == [0.5] * 3
    assert "Replans without a path of astar, ia_star, mt_d_star_lite: start blocked in 1." in outcome.about
    assert any("costs exact" in line for line in outcome.about)


EXACT, CELLS = Rules(costs="exact"), (1.0, math.sqrt(2))


def graph_of(blocked, weights=CELLS) -> nx.Graph:
    """Cells (col, row) and the legal steps between them, by the rule as it is written down."""
    rows, cols = blocked.shape
    graph = nx.Graph()
    free = {(col, row) for row in range(rows) for col in range(cols) if not blocked[row, col]}
    graph.add_nodes_from(free)
    for col, row in free:
        for dcol, drow in ((1, 0), (0, 1), (1, 1), (-1, 1)):
            beside = {(col + dcol, row), (col, row + drow)}
            if (col + dcol, row + drow) in free and beside <= free:
                graph.add_edge((col, row), (col + dcol, row + drow), weight=weights[bool(dcol and drow)])
    return graph


def some_queries(blocked, graph, count, rng):
    """(start, goal, length) of the shortest way, each of which exists."""
    component = sorted(max(nx.connected_components(graph), key=len))
    for i, j in rng.integers(0, len(component), (count, 2)).tolist():
        start, goal = component[i], component[j]
        yield start, goal, nx.dijkstra_path_length(graph, start, goal)


def test_costs_of_a_scen_are_the_listed_ones(static):
    """Planners that are optimal, asked in cells of 1 and the root of 2, find the lengths that networkx finds."""
    rng = np.random.default_rng(4)
    blocked = rng.random((14, 19)) < 0.25
    queries = list(some_queries(blocked, graph_of(blocked), 12, rng))
    source = static(blocked, queries)
    assert source.count == 12
    names = ["astar", "dijkstra", "mt_d_star_lite", "ea_star"]
    replans = ask_everything(source, names, EXACT, Silent())
    scenarios = scenarios_of(source, replans)
    optimal = scenarios["planner"] != "ea_star"
    assert_allclose(scenarios["listed_cost"], [each[2] for each in queries] * 4, rtol=0, atol=1e-12)
    assert scenarios["found"].all()
    assert_allclose(scenarios["cost"][optimal], scenarios["listed_cost"][optimal], rtol=0, atol=1e-5)
    assert_allclose(replans["cost"], scenarios["cost"], rtol=0, atol=1e-9)
    assert (scenarios["cost"] >= scenarios["listed_cost"] - 1e-9).all()


def test_rows_count_from_the_top(static):
    """(col, row) of the file in the table."""
    source = static(["...@", "@@.@"], ((0, 0), (2, 1)))
    columns = ask_everything(source, ["astar"], EXACT, Silent())
    assert [columns[name][0] for name in ("start_col", "start_row", "goal_col", "goal_row")] == [0, 0, 2, 1]


def test_a_ros_map_is_grown_but_the_unknown_only_blocks(tmp_path):
    cells = np.zeros((20, 30), np.int8)
    cells[8:12, 10:13] = 100
    cells[:, 27:] = -1
    write_rosmap(tmp_path, cells, np.array([-1.0, 2.0]), 0.1)
    source = ros_map_source(tmp_path / "map.yaml", "map.yaml", ((2, 9), (25, 9)), Growth())
    (question,) = next(iter(source.episodes()))
    grown = INFLATIONS["euclidean"](cells == 100, 3.0)
    assert_array_equal(question.query.blocked, grown | (cells < 0))
    assert not question.query.blocked[9, 26]
    answers = ask_everything(source, ["astar"], Rules(), Silent())
    # Cells of map's lattice, whose origin is 10 cells right of and 20 below the picture's corner.
    assert [answers[name][0] for name in ("start_col", "start_row", "goal_col", "goal_row")] == [-8, 29, 15, 29]
    graph = graph_of(question.query.blocked, (10, 14))
    assert answers["cost"][0] == nx.dijkstra_path_length(graph, (2, 9), (25, 9))


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Path]:
    """The beginning of the committed recording, of the topics to keep."""
    return lambda seconds, keep: cut(
        FIXTURES / "follow.mcap", tmp_path / "cut.mcap", seconds, lambda _, topic: keep(topic)
    )


def test_a_recording_asks_what_its_run_asks(recorded, planned_run, tmp_path):
    config = load_config(FIXTURES / "follow.toml")
    path = recorded(1.0, lambda topic: True)
    source, loss = recording_source(path, "cut.mcap", config, tmp_path / "run", 0, Silent())
    assert (source.name, loss) == ("cut.mcap", "")
    columns = ask_everything(source, ["astar"], Rules(), Silent())
    of_run = ask_everything(run_source(planned_run, "run"), ["astar"], Rules(), Silent())
    count = len(columns["t_ns"])  # the last scan was logged after the cut
    assert count == len(of_run["t_ns"]) - 1
    for name in ("t_ns", "expanded", "start_col", "start_row", "goal_col", "goal_row"):
        assert_array_equal(columns[name], of_run[name][:count], name)
    blind = recorded(0.5, lambda topic: topic != "/lidar/points")
    with pytest.raises(MissingInput, match=r"cut\.mcap: no topic is fit to be the lidar"):
        recording_source(blind, "cut.mcap", load_config(None), tmp_path / "blind", 0, Silent())


def test_its_questions_are_those_of_the_stage_plan(planned_run):
    """The stage's planner, asked again, does and costs the same, in the same cells."""
    columns = ask_everything(run_source(planned_run, "walk"), ["ia_star"], Rules(), Silent())
    plans, cell_m = read_table(planned_run, "plans"), load_maps(planned_run).cell_m
    assert set(plans["planner"]) == set(columns["planner"]) == {"ia_star"}
    assert len(plans["t_ns"]) == 10
    for name in ("t_ns", "found", "expanded", "generated", "cost", "optimal_cost", "from_scratch", "reused_cells"):
        assert_array_equal(columns[name], plans[name], name)
    assert_array_equal(columns["goal_projected"], plans["goal_projected"])
    assert not all(plans["from_scratch"])  # it did build on the plan before
    for end in ("start", "goal"):
        for axis, cell in (("x", "col"), ("y", "row")):
            assert_array_equal(columns[f"{end}_{cell}"], np.floor(plans[f"{end}_{axis}_m"] / cell_m), end)
