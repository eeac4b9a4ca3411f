from __future__ import annotations

import math

import networkx as nx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadlog.mapping.inflation import INFLATIONS
from quadlog.pipelines.comparison.compare import ask_everything, scenarios_of
from quadlog.pipelines.comparison.sources import movingai_source, ros_map_source
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.registry import OPTIMAL
from quadlog.planning.rules import Rules
from quadlog.results.studies.planners import QuestionSample
from quadlog.storage.formats.ros_map import write_rosmap

EXACT = Rules(costs="exact")
CELLS = (1.0, math.sqrt(2))
CORNER = ["..@", "...", "@.."]  # from (1, 0) to (2, 1) past one blocked cell


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


@pytest.mark.parametrize("costs", ["exact", "integer"])
def test_costs_of_a_scen_are_the_listed_ones(write_map, write_scen, costs):
    """Planners that are optimal, asked in cells of 1 and the root of 2, find the lengths that networkx finds."""
    rng = np.random.default_rng(4)
    blocked = rng.random((14, 19)) < 0.25
    queries = list(some_queries(blocked, graph_of(blocked), 12, rng))
    source = movingai_source(write_map(blocked), "small.map", write_scen(blocked.shape, queries), None)
    assert source.count == 12
    names = ["astar", "dijkstra", "mt_d_star_lite", "ea_star"]
    replans = ask_everything(source, names, Rules(costs=costs), Silent()).columns
    scenarios = scenarios_of(source, replans)
    optimal = np.isin(scenarios["planner"], OPTIMAL)
    assert_allclose(scenarios["listed_cost"], [each[2] for each in queries] * 4, rtol=0, atol=1e-12)
    assert scenarios["found"].all()
    if costs == "exact":
        assert_allclose(scenarios["cost"][optimal], scenarios["listed_cost"][optimal], rtol=0, atol=1e-5)
        assert_allclose(replans["cost"], scenarios["cost"], rtol=0, atol=1e-9)
    else:
        # Each planner's path is the cheapest in tens and fourteens; its length is in cells all the same.
        whole = graph_of(blocked, (10, 14))
        best = [nx.dijkstra_path_length(whole, start, goal) for start, goal, _ in queries]
        assert_array_equal(replans["cost"][optimal], best * 3)
        assert (scenarios["cost"] >= scenarios["listed_cost"] - 1e-9).all()
        assert (scenarios["cost"] < 1.02 * scenarios["listed_cost"] + 1e-9)[optimal].all()
    assert (scenarios["cost"] >= scenarios["listed_cost"] - 1e-9).all()


@pytest.mark.parametrize(("corner_cutting", "length"), [(False, 2.0), (True, math.sqrt(2))])
def test_a_diagonal_needs_both_cells_beside_it_unless_told(write_map, corner_cutting, length):
    source = movingai_source(write_map(CORNER), "small.map", None, ((1, 0), (2, 1)))
    rules = Rules(costs="exact", corner_cutting=corner_cutting)
    columns = ask_everything(source, ["astar", "dijkstra"], rules, Silent()).columns
    assert_allclose(columns["length_m"], length)
    assert_allclose(columns["cost"], length)


@pytest.mark.parametrize(
    ("lines", "start", "goal", "why_not"),
    [
        (["..", ".@"], (0, 0), (1, 1), "goal blocked"),
        (["@.", ".."], (0, 0), (1, 1), "start blocked"),
        (["..@", ".@.", "@.."], (0, 0), (2, 2), "unreachable"),
    ],
)
def test_a_query_without_an_answer_says_why(write_map, lines, start, goal, why_not):
    source = movingai_source(write_map(lines), "small.map", None, (start, goal))
    columns = ask_everything(source, ["astar", "ia_star", "lpa_star", "ara_star"], EXACT, Silent()).columns
    assert set(columns["why_not"]) == {why_not}
    assert not columns["found"].any()
    for name in ("cost", "optimal_cost", "length_m", "turn_rad"):
        assert np.isnan(columns[name]).all(), name


def test_rows_count_from_the_top(write_map):
    """(col, row) of the file in the table; the page's map has y upwards."""
    source = movingai_source(write_map(["...@", "@@.@"]), "small.map", None, ((0, 0), (2, 1)))
    sample = QuestionSample("query", source.row_zero_on_top)
    columns = ask_everything(source, ["astar"], EXACT, Silent(), sample=sample).columns
    row = {name: columns[name][0] for name in ("start_col", "start_row", "goal_col", "goal_row", "found")}
    assert row == {"start_col": 0, "start_row": 0, "goal_col": 2, "goal_row": 1, "found": True}
    (shown,) = sample.kept.values()
    assert sample.unit == "cells"
    assert_array_equal(shown.start, [0.5, 1.5])
    assert_array_equal(shown.goal, [2.5, 0.5])
    assert np.unpackbits(shown.bits, axis=2, count=4)[0].tolist() == [[1, 1, 0, 1], [0, 0, 0, 1]]


def test_a_ros_map_is_grown_but_the_unknown_only_blocks(tmp_path):
    cells = np.zeros((20, 30), np.int8)
    cells[8:12, 10:13] = 100
    cells[:, 27:] = -1
    write_rosmap(tmp_path, cells, np.array([-1.0, 2.0]), 0.1)
    source = ros_map_source(tmp_path / "map.yaml", "map.yaml", ((2, 9), (25, 9)), 0.3, "euclidean")
    (question,) = next(iter(source.episodes()))
    grown = INFLATIONS["euclidean"](cells == 100, 3.0)
    assert_array_equal(question.query.blocked, grown | (cells < 0))
    assert not question.query.blocked[9, 26]
    answers = ask_everything(source, ["astar"], Rules(), Silent())
    # Cells of map's lattice, whose origin is 10 cells right of and 20 below the picture's corner.
    assert [answers.columns[name][0] for name in ("start_col", "start_row", "goal_col", "goal_row")] == [-8, 29, 15, 29]
    graph = graph_of(question.query.blocked, (10, 14))
    assert answers.columns["cost"][0] == nx.dijkstra_path_length(graph, (2, 9), (25, 9))
