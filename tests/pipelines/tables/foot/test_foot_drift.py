"""The table foot-drift from walks that are made up: what a row says of them, and which of them it is made of."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from scipy.stats import ttest_rel

from quadlog.config.control import Trot
from quadlog.pipelines.tables.foot import drift_walks as drift_study
from quadlog.pipelines.tables.foot.drift import make_table
from quadlog.pipelines.tables.foot.drift_walks import (
    ALTERNATING,
    BASELINE,
    CHOOSING_SEEDS,
    DERIVED,
    DRIFT,
    FORWARD,
    ROBOTS,
    SAME_SIDE,
    SIGNED_DRIFT,
    SYMMETRIC,
    Curve,
    Drifted,
    Drifts,
    DriftTask,
    change_row,
    changes,
    choose,
    mean_interval,
    reported_seeds,
    settings,
    side,
    walk_task,
)
from quadlog.results.papers.table import PaperRow, PaperTable

FIGURES = ("lateral_drift_m", "yaw_rate_degps", "forward_m", "roll_range_deg", "pitch_range_deg")
Rule = Callable[[DriftTask], dict[str, float]]


def _made_up(rule: Rule, tasks: Iterable[DriftTask]) -> Drifts:
    t_s = np.linspace(0, 32, 40)
    return {
        task: Drifted(dict.fromkeys(FIGURES, 1.0) | rule(task), 0.01, t_s, 0.01 * np.sin(t_s), 0.01 * np.cos(t_s))
        for task in tasks
    }


def _noise(task: DriftTask) -> float:
    """The same for all curves of a robot and seed, and then a little of the curve's own."""
    own = np.random.default_rng([task.seed, list(ROBOTS).index(task.robot)]).normal()
    curve = np.random.default_rng([task.seed, zlib.crc32(repr(task.curve).encode())]).normal()
    return 0.02 * own + 0.001 * curve


def _as_claimed(task: DriftTask) -> dict[str, float]:
    """What the paper says, of every robot."""
    bulges = task.curve.k is not None
    return {
        "lateral_drift_m": -(0.04 if bulges else 0.28) + 0.1 * _noise(task),
        "yaw_rate_degps": (0.03 if bulges else -0.25) + 0.01 * _noise(task),
        "forward_m": (2.6 if bulges else 2.5) + 0.1 * _noise(task),
    }


def _not_as_claimed(task: DriftTask) -> dict[str, float]:
    bulges = task.curve.k is not None
    return {
        "lateral_drift_m": (0.28 if bulges else 0.04) + 0.1 * _noise(task),
        "yaw_rate_degps": _noise(task),
        "forward_m": (2.4 if bulges else 2.5) + 0.1 * _noise(task),
    }


@pytest.fixture
def table_of(monkeypatch) -> Callable[[Rule, bool], PaperTable]:
    def make(rule: Rule, fast: bool) -> PaperTable:
        monkeypatch.setattr(drift_study, "walk_all", lambda tasks: _made_up(rule, tasks))
        return make_table(fast, 0)

    return make


def _row(table: PaperTable, quantity: str) -> PaperRow:
    return {row.quantity: row for row in table.rows}[quantity]


@pytest.mark.parametrize("fast", [False, True])
def test_what_the_paper_claims_reproduces_where_it_holds(table_of, fast):
    table = table_of(_as_claimed, fast)
    claimed = [row for row in table.rows if "change of" in row.quantity]
    assert len(claimed) == (3 if fast else 7) * len(ROBOTS)
    assert all(row.reproduces for row in claimed)
    assert _row(table, f"{SYMMETRIC}, without y(t): size of drift (mm)").reproduces
    assert _row(table, f"{SYMMETRIC}, with y(t): size of yaw rate (°/s)").reproduces
    text = table.groups[0].text
    assert text.startswith("On most robots less drift and a lower yaw rate and a longer way survives of the claim.")
    assert re.search(rf"{SYMMETRIC}: 2[78]\d mm without y\(t\), [34]\d mm with the derived one", text)
    assert ("with a trim to one side" in text) != fast
    assert _row(table, "the derived curve: robots that drift less (of 8)").ours == 8
    assert _row(table, "the derived curve: robots that drift more (of 8)").ours == 0


def test_what_does_not_hold_does_not_reproduce(table_of):
    table = table_of(_not_as_claimed, True)
    row = _row(table, f"{SYMMETRIC}, with y(t): change of drift (mm)")
    assert (row.reproduces, row.paper) == (False, -240.0)
    assert row.ours == pytest.approx(240, abs=10)
    assert "other way round" in row.note
    assert not _row(table, f"{SYMMETRIC}, with y(t): change of way forward (m)").reproduces
    assert _row(table, "the derived curve: robots that drift more (of 8)").ours == 8
    assert table.groups[0].text.startswith("On most robots nothing survives of the claim; not less drift (on no robot)")
    assert "100 mm and more: none." in table.groups[0].text


def test_what_is_chosen_is_chosen_on_other_seeds_than_reported(monkeypatch):
    asked: list[list[DriftTask]] = []

    def walk(tasks: Iterable[DriftTask]) -> Drifts:
        asked.append(list(tasks))
        return _made_up(_as_claimed, asked[-1])

    monkeypatch.setattr(drift_study, "walk_all", walk)
    study = drift_study.measure_drifts(False, 3)
    choosing, reporting = ({task.seed for task in tasks} for tasks in asked)
    assert choosing == set(CHOOSING_SEEDS)
    assert reporting == set(study.seeds)
    assert len(study.seeds) == 10
    assert not choosing & reporting


def test_the_curve_with_which_a_robot_turns_least_is_chosen():
    def rule(task: DriftTask) -> dict[str, float]:
        rates = {350.0: -0.3, 175.0: 0.2, 88.0: -0.5 if task.seed == CHOOSING_SEEDS[0] else 0.6}
        return {"yaw_rate_degps": rates.get(task.curve.k, 1.0)}

    drifts = _made_up(rule, [DriftTask(SYMMETRIC, curve, seed) for curve in ALTERNATING for seed in CHOOSING_SEEDS])
    assert choose(drifts, SYMMETRIC, ALTERNATING) == DERIVED


def test_seeds_of_two_tables_have_none_in_common():
    assert not set(reported_seeds(10, 0)) & set(reported_seeds(10, 1))
    assert not set(reported_seeds(10, 0)) & set(CHOOSING_SEEDS)


def test_robots_are_one_symmetric_and_six_that_are_not():
    asymmetries = {"payload_kg", "leg_mass_spread", "hip_offset_m"}
    assert ROBOTS[SYMMETRIC] == {}
    assert sum(bool(asymmetries & set(keys)) for keys in ROBOTS.values()) >= 6
    for robot, keys in ROBOTS.items():
        for curve in (BASELINE, *ALTERNATING, *SAME_SIDE):
            trot = settings(robot, curve).trot
            assert {name: getattr(trot, name) for name in keys} == keys
            assert trot.lateral == curve.lateral
            assert trot.foot_curve_k == (curve.k or Trot().foot_curve_k)


def test_a_change_is_judged_by_the_paired_t_test():
    rng = np.random.default_rng(1)
    values = {curve: rng.normal(size=10) for curve in (BASELINE, DERIVED)}
    seeds = range(10)

    def rule(task: DriftTask) -> dict[str, float]:
        return {"lateral_drift_m": values[task.curve][task.seed]}

    drifts = _made_up(rule, [DriftTask(SYMMETRIC, curve, seed) for curve in values for seed in seeds])
    found = ttest_rel(values[DERIVED], values[BASELINE]).confidence_interval(0.95)
    mean, (low, high) = mean_interval(changes(drifts, SYMMETRIC, DERIVED, seeds, SIGNED_DRIFT))
    assert mean == pytest.approx(1e3 * (values[DERIVED] - values[BASELINE]).mean())
    assert (low, high) == pytest.approx((1e3 * found.low, 1e3 * found.high))
    sizes = changes(drifts, SYMMETRIC, DERIVED, seeds, DRIFT)
    np.testing.assert_allclose(sizes, 1e3 * (np.abs(values[DERIVED]) - np.abs(values[BASELINE])))
    row = change_row(drifts, SYMMETRIC, DERIVED, seeds, FORWARD, "here")
    assert (row.ours, row.reproduces) == (0.0, False)
    assert "holds 0" in row.note


@pytest.mark.parametrize(("interval", "where"), [((-2, -1), -1), ((-1, 1), 0), ((0, 1), 0), ((1, 2), 1)])
def test_an_interval_is_on_a_side_only_if_all_of_it_is(interval, where):
    assert side(interval) == where


def test_a_walk_is_that_of_the_simulation(monkeypatch):
    from quadlog.simulation.robot import trot as trot_walk

    monkeypatch.setattr(trot_walk, "TROT_S", 2.0)
    walk = walk_task(DriftTask("left hips 20 mm ahead", Curve(-350.0, "same"), 5))
    assert walk.peak_m == pytest.approx(-0.005, rel=0.01)
    assert len(walk.t_s) == len(walk.y_m) == len(walk.yaw_rad) == 201
    assert walk.figures["lateral_drift_m"] == walk.y_m[-1] - walk.y_m[100]
    assert "realtime_factor" not in walk.figures
