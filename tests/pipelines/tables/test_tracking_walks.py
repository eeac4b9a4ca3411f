from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from quadlog.control.following.lookahead import HONEST, PAPER
from quadlog.pipelines.simulation.walk import disturbance_settings, fuzzy_settings, lookahead_control
from quadlog.pipelines.tables.tracking.table_5 import CONTROLLERS, KNOWN_BEST_M, LENGTHS_M, TUNED, best_fixed_m, fixed
from quadlog.pipelines.tables.tracking.walks import (
    CHOOSING_SEEDS,
    CURVES,
    ETA,
    LOOKAHEAD,
    SEEDS_PER_TABLE,
    SIGMA,
    TIME,
    Steering,
    Tracked,
    TrackingTask,
    held_out_seeds,
    mean_row,
    walk_task,
)
from quadlog.simulation.robot.disturbances import DISTURBED, NONE


def task(steering, disturbed=False, course="s-curve", terrain="course", seed=2000):
    return TrackingTask(course, terrain, steering, disturbed, seed)


def test_what_is_reported_was_never_chosen_on():
    assert max(CHOOSING_SEEDS) < 1000 <= 2000 <= held_out_seeds(10, 0)[0]
    drawn = [each for seed in range(4) for each in held_out_seeds(SEEDS_PER_TABLE, seed)]
    assert len(set(drawn)) == len(drawn)


def test_controllers_are_those_of_simulate():
    fpmw, fpm, pmw = (task(each).config for each in CONTROLLERS)
    assert [each.simulation.controller for each in (fpmw, fpm, pmw)] == ["fpmw", "fpm", "pmw"]
    assert fuzzy_settings(fpmw.pursuit) == fuzzy_settings(fpm.pursuit) == PAPER
    assert lookahead_control(pmw).step(0.1, 0.02, 0.5).l_m == 2.0
    assert lookahead_control(task(fixed(1.42)).config).step(0.1, 0.02, 0.5).l_m == 1.42


def test_tuned_rules_are_the_honest_ones():
    assert fuzzy_settings(task(TUNED).config.pursuit) == HONEST


def test_disturbed_means_what_simulate_means_by_it():
    assert disturbance_settings(task(CONTROLLERS[0], disturbed=True).config.simulation.disturbances) == DISTURBED
    assert asdict(disturbance_settings(task(CONTROLLERS[0]).config.simulation.disturbances)) == asdict(NONE)


def test_what_is_varied_reaches_the_walk():
    varied = replace(task(CONTROLLERS[1]), turning_share=0.3, friction=0.65).config
    assert (varied.mpc.turning_share, varied.simulation.friction) == (0.3, 0.65)
    usual = task(CONTROLLERS[1]).config
    assert (usual.mpc.turning_share, usual.simulation.friction) == (0.6, 0.8)


def walk(eta_m, fallen=0.0):
    return Tracked({"eta_m": eta_m, "fallen": fallen}, np.zeros(1), np.zeros(1))


def test_the_best_fixed_lookahead_is_the_smallest_error_of_those_that_stand():
    scan = {("ideal", length_m): [walk(0.01 * length_m), walk(0.03 * length_m)] for length_m in LENGTHS_M}
    assert best_fixed_m("ideal", scan) == min(LENGTHS_M)
    scan["ideal", min(LENGTHS_M)][1] = walk(0.0, fallen=1.0)
    assert best_fixed_m("ideal", scan) == sorted(LENGTHS_M)[1]
    assert best_fixed_m("disturbed", {}) == KNOWN_BEST_M["disturbed"]
    assert set(KNOWN_BEST_M.values()) <= set(LENGTHS_M)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A line of 2 m, walked twice, the second time with its curves."""
    path = tmp_path_factory.mktemp("course") / "short.csv"
    path.write_text("x_m,y_m\n" + "".join(f"{x_m:.2f},0\n" for x_m in np.arange(0, 2.01, 0.1)))
    mine = task(Steering("FpMW", "fpmw"), True, str(path), "3cm")
    return [walk_task(mine), walk_task(replace(mine, drawn=True))]


def test_a_short_walk_fills_its_rows(short):
    rows = [row for figure in (ETA, SIGMA, TIME, LOOKAHEAD) for row in mean_row("2 m", figure, short)]
    assert [row.quantity for row in rows] == [
        "2 m: η (m)",
        "2 m: σ (m)",
        "2 m: completion time (s)",
        "2 m: mean look-ahead (m)",
    ]
    eta_m, sigma_m, time_s, lookahead_m = (row.ours for row in rows)
    assert eta_m == pytest.approx(np.mean(short[0].error_m))
    assert sigma_m == pytest.approx(np.std(short[0].error_m, ddof=1))
    assert 0 < eta_m < 0.05
    assert 3 < time_s < 4.5
    assert time_s == pytest.approx(short[0].t_s[-1])
    assert 1 < lookahead_m < 2


def test_what_is_drawn_is_kept_and_its_figures_are_those_of_the_curves(short):
    first, drawn = short
    assert first.curves == {}
    assert set(drawn.curves) == set(CURVES)
    off_m = {axis: drawn.curves[f"{axis}_m"] - drawn.curves[f"ref_{axis}_m"] for axis in "xy"}
    assert np.hypot(off_m["x"], off_m["y"]) == pytest.approx(drawn.error_m)
    both = np.hypot(first.of("x_error_rms_m"), first.of("y_error_rms_m"))
    assert both == pytest.approx(np.sqrt(np.mean(drawn.error_m**2)))
    assert first.of("k_v_range") == pytest.approx(np.ptp(drawn.curves["k_v"]))
