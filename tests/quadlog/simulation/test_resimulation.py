from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from quadlog.control.following.lookahead import CORRECTED, FixedLookahead, FuzzyLookahead, infer
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.control.settings import PursuitSettings
from quadlog.errors import TooLarge
from quadlog.mapping.grid import window_around
from quadlog.planning.query import Growth
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Replanner
from quadlog.results.tables import TABLES
from quadlog.simulation.contacts import Footprint
from quadlog.simulation.course_walk import Driver
from quadlog.simulation.resimulation import MapInstant, resimulate
from quadlog.simulation.robot.height_field import flat
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
from quadlog.simulation.robot.walking_robot import WalkingRobot
from quadlog.simulation.settings import RATE_HZ

BODY = Footprint(0.62, 0.26)
START_NS = 1_700_000_000_000_000_000


def instants(count, period_s=0.1, centre=(0.0, 0.0), wall=False, size=200):
    for i in range(count):
        window = window_around(np.array(centre, dtype=float), 0.1, size)
        occupied = np.zeros(window.shape, dtype=bool)
        if wall:
            col, row = window.cell_of(np.array([2.0, 0.0]))
            occupied[row - 10 : row + 10, col] = True
        yield MapInstant(START_NS + round(i * period_s * 1e9), window, occupied)


def fixed(x, y):
    return lambda t_ns: np.tile([x, y], (len(t_ns), 1)).astype(float)


def run(
    maps, target, planner="ia_star", pose=(0.0, 0.0, 0.0), stop_short_m=1.0, lookahead=None, lookahead_m=2.0, **chord
):
    replanner = Replanner(make_planner(planner), Growth(), stop_short_m)
    robot = UnicycleRobot(np.array(pose), 1 / RATE_HZ, np.random.default_rng(0))
    driver = Driver(robot, lookahead or FixedLookahead(lookahead_m), 0.6, 1.5)
    return resimulate(maps, target, driver, replanner, BODY, **chord)


@pytest.mark.parametrize("planner", ["astar", "ia_star"])
def test_walks_to_a_metre_from_a_standing_person(planner):
    walk = run(instants(100), fixed(4.0, 1.0), planner)
    control = walk.control
    assert list(control) == TABLES["control"].names
    assert {len(column) for column in control.values()} == {496}
    assert control["t_ns"][0] == START_NS
    assert control["t_ns"][-1] == START_NS + 9_900_000_000
    assert (np.diff(control["t_ns"]) == 20_000_000).all()
    assert walk.target_distance_m[0] == pytest.approx(np.hypot(4, 1))
    assert walk.target_distance_m[-1] == pytest.approx(1.0, abs=0.07)
    assert walk.target_distance_m.min() > 0.9
    assert len(walk.plans) == 100
    assert [plan["t_ns"] for plan in walk.plans[:2]] == [START_NS, START_NS + 100_000_000]
    assert walk.outside_ticks == walk.outside_replans == 0


def test_walks_round_a_wall_with_clearance():
    walk = run(instants(150, wall=True), fixed(5.0, 0.0), lookahead_m=0.5)
    assert walk.target_distance_m[-1] < 1.2
    assert walk.clearance_m.min() > 0.0
    assert walk.clearance_m.min() < 0.3
    assert np.abs(walk.control["y_m"]).max() > 1.0


def test_outside_the_window_the_last_plan_is_kept_and_ticks_are_counted():
    """The recorded window stays where it was while the robot walks on towards a far target."""
    near = list(instants(60, size=30))
    walk = run(near, fixed(30.0, 0.0))
    inside = list(instants(60, size=31, centre=(50.0, 0.0)))
    jumped = [near[0], *inside[1:]]
    held = run(jumped, fixed(30.0, 0.0))
    assert walk.outside_ticks == 0
    assert len(held.plans) == 1
    assert held.outside_replans == 59
    assert held.outside_ticks == len(held.control["t_ns"]) - 5
    assert np.isnan(held.clearance_m[5:]).all()
    # Its one plan ends on the first window's margin.
    assert held.control["x_m"][-1] == pytest.approx(1.45, abs=0.1)


def test_uneven_and_equal_instants_lose_no_tick():
    maps = list(instants(6))
    times_s = [0.0, 0.013, 0.013, 0.05, 0.051, 0.3]
    maps = [dataclasses.replace(m, t_ns=START_NS + round(t * 1e9)) for m, t in zip(maps, times_s, strict=True)]
    walk = run(maps, fixed(4.0, 0.0))
    assert len(walk.plans) == 6
    np.testing.assert_array_equal(walk.control["t_ns"] - START_NS, np.arange(16) * 20_000_000)


def test_a_clock_that_jumps_is_refused_before_anything_is_allocated():
    (first,) = instants(1)
    with pytest.raises(TooLarge, match="ticks"):
        run([first, dataclasses.replace(first, t_ns=START_NS + 10**18)], fixed(4.0, 0.0))
    with pytest.raises(ValueError, match="order"):
        run([first, dataclasses.replace(first, t_ns=START_NS - 1), first], fixed(4.0, 0.0))


@pytest.mark.parametrize("has_body", [False, True])
def test_after_a_gap_the_walk_begins_again_and_nothing_is_walked_in_it(has_body):
    """A part after a gap is, tick by tick, the walk of that part alone; a plan that was held ends with its part."""
    model, gap_ns = quadruped_model(ROBOTS["tracking"], flat()), 2_000_000_000

    def walk(maps, pose):
        rng = np.random.default_rng(0)
        made = UnicycleRobot(pose, 1 / RATE_HZ, rng)
        robot = WalkingRobot(model, WalkerSettings(), pose, rng) if has_body else made
        replanner = Replanner(make_planner("d_star_lite"), Growth(), 1.0)
        return resimulate(maps, fixed(4.0, 1.0), Driver(robot, FixedLookahead(0.6), 0.6, 1.5), replanner, BODY)

    first, second = list(instants(8)), list(instants(8, wall=True))
    away, again = np.array([0.0, 0.0, 0.5]), np.array([0.5, -1.0, 0.2])
    late = [dataclasses.replace(each, t_ns=each.t_ns + gap_ns) for each in second]
    late[0] = dataclasses.replace(late[0], start_pose=again)
    both, alone = walk([*first, *late], away), walk(second, again)
    ticks = len(alone.control["t_ns"])
    assert (ticks, len(both.control["t_ns"])) == (36, 72)
    np.testing.assert_array_equal(both.control["t_ns"][ticks:], alone.control["t_ns"] + gap_ns)
    for name in TABLES["control"].names:
        if name not in ("t_ns", "energy_j", "us_median", "us_max"):
            np.testing.assert_array_equal(both.control[name][ticks:], alone.control[name], name)
    assert [plan["expanded"] for plan in both.plans[8:]] == [plan["expanded"] for plan in alone.plans]


def test_a_robot_with_a_body_walks_as_the_plan_goes():
    """The kinematic robot is the oracle: 14 kg of robot follow the same plans, some centimetres behind and beside."""
    model = quadruped_model(ROBOTS["tracking"], flat())
    robot = WalkingRobot(model, WalkerSettings(), np.array([0.0, 0.0, 0.3]), np.random.default_rng(0))
    replanner = Replanner(make_planner("astar"), Growth(), 1.0)
    driver = Driver(robot, FixedLookahead(0.6), 0.6, 1.5)
    walk = resimulate(instants(30, wall=True), fixed(4.0, 1.0), driver, replanner, BODY)
    light = run(instants(30, wall=True), fixed(4.0, 1.0), "astar", (0.0, 0.0, 0.3), lookahead_m=0.6)
    control = walk.control
    assert list(control) == TABLES["control"].names
    assert not control["fallen"].any()
    away_m = np.hypot(control["x_m"] - light.control["x_m"], control["y_m"] - light.control["y_m"])
    # Half a second goes into gathering speed.
    assert away_m.max() < 0.25
    assert np.nanmax(control["plan_error_m"]) < 0.06
    # Beside a plan held for six seconds it is as far as the robot without a body, which walks the same newer plans.
    assert abs(np.nanmax(control["error_m"]) - np.nanmax(light.control["error_m"])) < 0.06
    # Its feet carry it.
    loads_n = np.sum([control[f"fz_{leg}_n"][25:] for leg in range(4)], axis=0)
    assert loads_n.mean() == pytest.approx(model.robot.mass_kg * 9.81, rel=0.05)
    assert np.isfinite(control["tau_00_nm"]).all()
    assert (walk.clearance_m > 0).all()


def test_a_plan_is_the_reference_for_as_long_as_walking_it_takes():
    """Turned by a radian the robot leaves a plan of 3 m; no newer plan, which starts where it is, hides that."""
    walk = run(instants(40, period_s=0.25), fixed(4.0, 0.0), "astar", pose=(0.0, 0.0, 1.0))
    control, until_s = walk.control, math.ceil(walk.plans[0]["length_m"] / 0.6 / 0.25) * 0.25
    assert until_s == pytest.approx(5.0, abs=0.3)
    t_s = (control["t_ns"] - control["t_ns"][0]) * 1e-9
    held = t_s < until_s
    here = np.column_stack([control["x_m"], control["y_m"]])
    # The plan's length over its speed, to the next map; the cells' centres lie 5 cm beside y = 0 for some way.
    np.testing.assert_allclose(control["error_m"][held], np.abs(here[held, 1]), atol=0.051)
    assert control["error_m"][held].max() > 0.2
    assert control["plan_error_m"].max() < 0.25 * 0.6
    reference = np.column_stack([np.minimum(0.6 * t_s, walk.plans[0]["length_m"]), np.zeros(len(t_s))])
    np.testing.assert_allclose(
        control["time_error_m"][held], np.hypot(*(reference - here)[held].T), atol=0.06, err_msg="0.6 m/s along x"
    )
    # Then comes the plan made where the robot is at that map's instant.
    assert control["error_m"][np.isclose(t_s, until_s)] == pytest.approx(0.0, abs=1e-9)


def test_the_fuzzy_look_ahead_is_set_by_the_error_beside_the_held_plan():
    """Turned by a radian, maps ten times a second: error, rate and look-ahead move, and no other fixed one does so."""
    given = {"target": fixed(4.0, 0.0), "planner": "astar", "pose": (0.0, 0.0, 1.0)}
    control = run(instants(48), **given, lookahead=FuzzyLookahead(PursuitSettings())).control
    error_m, k = control["error_m"], np.column_stack([control["k_v"], control["k_w"]])
    rate_mps = np.diff(error_m, prepend=error_m[0]) * 50.0
    expected = [infer(e, ec, CORRECTED) for e, ec in zip(error_m.tolist(), rate_mps.tolist(), strict=True)]
    np.testing.assert_allclose(k, expected, atol=1e-9)
    assert np.ptp(error_m) > 0.2
    assert np.ptp(rate_mps) > 0.3
    assert (np.ptp(k, axis=0) > 0.4).all()
    assert np.ptp(control["lookahead_m"]) > 0.3
    as_long = run(instants(48), **given, lookahead_m=float(control["lookahead_m"].mean())).control
    assert np.hypot(*(control[each] - as_long[each] for each in ("x_m", "y_m"))).max() > 0.02


@pytest.mark.parametrize("clear_chord", [True, False])
def test_a_look_ahead_longer_than_the_plan_does_not_cut_its_corner(clear_chord):
    """The plan ends a metre short of a person behind a wall's end; what is aimed at lies behind the wall without it."""
    maps = list(instants(120))
    for each in maps:
        col, row = each.window.cell_of(np.array([2.0, 0.0]))
        each.occupied[row - 60 : row + 5, col] = True
    walk = run(maps, fixed(3.2, -0.6), pose=(0.6, -1.0, 0.5), clear_chord=clear_chord)
    assert bool(walk.clearance_m.min() > 0.05) is clear_chord
    assert bool(walk.contacts) is not clear_chord
    if not clear_chord:
        (first, *_) = walk.contacts
        assert first.collision
        assert first.cause == "cut_corner"
        assert first.x_m == pytest.approx(2.05)
        assert first.clearance_m <= 0


def test_every_collision_is_listed_with_its_time_and_no_other():
    """A blind walk through a wall that only the whole run's map knows, and a false point inside the body on the way."""
    maps = [
        dataclasses.replace(each, standing=wall.occupied)
        for each, wall in zip(instants(100), instants(100, wall=True), strict=True)
    ]
    free = run(maps[:30], fixed(5.0, 0.0), "astar")
    x_m = free.control["x_m"][100]  # where it is at the 20th map
    for each in maps[20:22]:
        col, row = each.window.cell_of(np.array([x_m, 0.0]))
        each.occupied[row, col] = True
    walk = run(maps, fixed(5.0, 0.0), "astar")
    counted = [each for each in walk.contacts if each.collision]
    begins = (walk.clearance_m <= 0) & ~np.concatenate([[False], walk.clearance_m[:-1] <= 0])
    assert [each.t_ns for each in counted] == walk.control["t_ns"][begins].tolist()
    assert {each.cause for each in counted} == {"unseen"}
    (appeared,) = [each for each in walk.contacts if not each.collision]
    assert appeared.cause == "appeared"
    assert appeared.t_ns == maps[20].t_ns
    assert (walk.clearance_m[100:110] > 0).all()
