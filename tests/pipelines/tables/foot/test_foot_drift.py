"""Statistics of the walks behind foot-drift, from walks that are made up, and one that is not."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pytest
from scipy.stats import ttest_rel

from quadlog.config.control import Trot
from quadlog.pipelines.tables.foot import drift_walks as drift_study
from quadlog.pipelines.tables.foot.drift_walks import (
    ALTERNATING,
    BASELINE,
    CHOOSING_SEEDS,
    DERIVED,
    DRIFT,
    FORWARD,
    FRICTION,
    OTHER_FRICTIONS,
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

FIGURES = ("lateral_drift_m", "yaw_rate_degps", "forward_m", "roll_range_deg", "pitch_range_deg")
Rule = Callable[[DriftTask], dict[str, float]]


def _made_up(rule: Rule, tasks: Iterable[DriftTask]) -> Drifts:
    t_s = np.linspace(0, 32, 40)
    return {
        task: Drifted(dict.fromkeys(FIGURES, 1.0) | rule(task), 0.01, t_s, 0.01 * np.sin(t_s), 0.01 * np.cos(t_s))
        for task in tasks
    }


def test_what_is_chosen_is_chosen_on_other_seeds_than_reported(monkeypatch):
    asked: list[list[DriftTask]] = []

    def walk(tasks: Iterable[DriftTask]) -> Drifts:
        asked.append(list(tasks))
        return _made_up(lambda task: {}, asked[-1])

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
    assert (row.ours, row.reproduces, row.paper) == (0.0, "no", None)


@pytest.mark.parametrize(
    ("less_mm", "noise_mm", "verdict", "note"),
    [
        (-100.0, 1.0, "yes", "Claimed: less than 0."),
        (-100.0, 300.0, "undecided", "Claimed: less than 0."),
        # Surely less, and not by a tenth of the printed 240 mm.
        (-5.0, 1.0, "no", "Claimed: less than 0. By less than a tenth of what is printed, -24."),
        (50.0, 1.0, "no", "Claimed: less than 0. The other way round."),
    ],
)
def test_a_smaller_drift_is_claimed_and_a_tenth_of_what_is_printed_is_the_least(less_mm, noise_mm, verdict, note):
    noise = np.random.default_rng(2).normal(0, noise_mm / 1e3, 10)

    def rule(task: DriftTask) -> dict[str, float]:
        return {"lateral_drift_m": 10.0 if task.curve.k is None else 10.0 + less_mm / 1e3 + noise[task.seed]}

    drifts = _made_up(rule, [DriftTask(SYMMETRIC, curve, s) for curve in (BASELINE, DERIVED) for s in range(10)])
    row = change_row(drifts, SYMMETRIC, DERIVED, range(10), DRIFT, "here")
    assert (row.reproduces, row.note) == (verdict, note)


def test_friction_is_that_of_the_simulation():
    assert settings(SYMMETRIC, DERIVED).friction == FRICTION
    assert settings(SYMMETRIC, DERIVED, OTHER_FRICTIONS[0]).friction == OTHER_FRICTIONS[0]


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
