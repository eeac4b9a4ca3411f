from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadlog.pipelines.comparison.compare import ask_everything, repeats_for, scenarios_of
from quadlog.pipelines.comparison.sources import forest_source, movingai_source
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.rules import Rules
from quadlog.results.studies.planners import REPLANS, SCENARIOS

NAMES = ["astar", "clearance_astar", "ia_star"]


class Steps(Silent):
    def __init__(self) -> None:
        self.count = 0

    def advance(self, recorded_s: float | None = None) -> None:
        self.count += 1


@pytest.fixture
def scen_source(write_map, write_scen):
    """The second query is the longest one, and clearance A* looks at more cells than A* on every one."""
    blocked = np.zeros((20, 20), dtype=bool)
    blocked[3:18, 9] = True
    queries = [((0, 0), (2, 0), 2), ((6, 10), (12, 10), 0), ((0, 0), (6, 1), 6.4)]
    return movingai_source(write_map(blocked), "small.map", write_scen(blocked.shape, queries), None)


@pytest.mark.parametrize("kind", ["static", "walk"])
def test_every_planner_answers_every_question(scen_source, kind):
    source = scen_source if kind == "static" else forest_source("forest:0.1", 2, "astar", Rules(), "euclidean", 3)
    progress = Steps()
    answers = ask_everything(source, NAMES, Rules(), progress)
    columns = answers.columns
    assert list(columns) == REPLANS.names
    assert progress.count == source.count
    asked = {}
    for name in NAMES:
        mine = columns["planner"] == name
        asked[name] = {each: columns[each][mine] for each in ("episode", "replan", "t_ns", "start_col", "goal_row")}
    for each in asked["astar"]:
        assert_array_equal(asked["astar"][each], asked["ia_star"][each], each)
        assert_array_equal(asked["astar"][each], asked["clearance_astar"][each], each)
    scenarios = scenarios_of(source, columns)
    assert scenarios is None if kind == "walk" else sorted(scenarios) == sorted(SCENARIOS.names)
    assert_array_equal(
        columns["optimal_cost"][columns["planner"] == "astar"], columns["cost"][columns["planner"] == "astar"]
    )


@pytest.mark.parametrize("kind", ["static", "walk"])
def test_repeats_change_times_alone(scen_source, kind):
    source = scen_source if kind == "static" else forest_source("forest:0.2", 1, "astar", Rules(), "euclidean", 3)
    once, often = (ask_everything(source, NAMES, Rules(), Silent(), repeats) for repeats in (1, 4))
    for name in set(REPLANS.names) - {"us"}:
        assert_array_equal(once.columns[name], often.columns[name], name)
    assert often.us_repeats.shape == (len(often.columns["us"]), 4)
    assert_array_equal(np.median(often.us_repeats, axis=1), often.columns["us"])


def test_a_single_question_is_asked_until_its_times_tell_planners_apart(write_map, scen_source):
    single = movingai_source(write_map(["..", ".."]), "small.map", None, ((0, 0), (1, 1)))
    assert [repeats_for(single, planners) for planners in (2, 12)] == [6, 9]
    assert repeats_for(scen_source, 12) == 3
