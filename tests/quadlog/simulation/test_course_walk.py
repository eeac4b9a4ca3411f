from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.control.following.lookahead import FixedLookahead, FuzzyLookahead
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.control.settings import PursuitSettings
from quadlog.simulation.course_walk import COURSES, SPACING_M, Course, walk_course
from quadlog.simulation.robot import height_field as ground
from quadlog.simulation.robot.disturbances import NONE
from quadlog.simulation.robot.model import TIMESTEP_S, quadruped_model
from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
from quadlog.simulation.robot.walking_robot import WalkingRobot
from quadlog.simulation.settings import DisturbanceSettings

BEND = Course("bend", np.array([[0.0, 0.0], [1.0, 0.0], [1.5, 0.3]]), 0.5)


def _unicycle(course, disturbances=NONE) -> UnicycleRobot:
    return UnicycleRobot(course.start_pose, TIMESTEP_S, np.random.default_rng(0), disturbances)


def _walk(course, robot, lookahead=None, **options):
    return walk_course(course, robot, lookahead or FixedLookahead(0.6), 1.5, **options)


def _legged(course, disturbances=NONE) -> WalkingRobot:
    model = quadruped_model(ROBOTS["tracking"], ground.flat())
    return WalkingRobot(model, WalkerSettings(), course.start_pose, np.random.default_rng(0), disturbances)


@pytest.fixture(scope="module")
def walk():
    return _walk(BEND, _legged(BEND), FuzzyLookahead(PursuitSettings()))


def test_ticks_are_evenly_apart_and_the_last_one_arrives(walk):
    control = walk.control
    assert set(np.diff(control["t_ns"])) == {20_000_000}
    assert walk.completed_ns == control["t_ns"][-1]
    assert np.hypot(control["x_m"][-1] - 1.5, control["y_m"][-1] - 0.3) <= 0.1
    assert not control["fallen"].any()
    assert walk.effort is not None
    assert walk.mass_kg == pytest.approx(12.786)


def test_errors_are_distances_to_the_course(walk):
    """Brute force: the nearest of points 1 mm apart."""
    control = walk.control
    fine = np.concatenate([np.linspace(a, b, 1000) for a, b in zip(BEND.path_m[:-1], BEND.path_m[1:], strict=True)])
    xy = np.column_stack([control["x_m"], control["y_m"]])
    nearest = np.hypot(*(xy[:, None] - fine[None]).transpose(2, 0, 1)).min(axis=1)
    np.testing.assert_allclose(control["error_m"], nearest, atol=1e-6 + 1e-3**2 / 0.001)
    np.testing.assert_array_equal(control["error_m"], np.abs(control["cross_track_m"]))
    away = np.hypot(control["ref_x_m"] - control["x_m"], control["ref_y_m"] - control["y_m"])
    np.testing.assert_allclose(away, control["error_m"], atol=1e-9)
    # On the first straight the timed reference walks along x at the course's speed.
    t_s = control["t_ns"][:90] * 1e-9
    timed = np.hypot(control["x_m"][:90] - 0.5 * t_s, control["y_m"][:90])
    np.testing.assert_allclose(control["time_error_m"][:90], timed, atol=1e-9)
    np.testing.assert_allclose(control["heading_error_rad"][:40], control["yaw_rad"][:40], atol=1e-9)


def test_a_unicycle_walks_a_line_without_error():
    line = COURSES["line"]()
    walk = _walk(line, _unicycle(line), FixedLookahead(2.0))
    assert walk.control["error_m"].max() < 1e-9
    assert walk.effort is None
    # All but the last 0.1 m, at a speed that braking hardly touches before.
    assert walk.completed_ns is not None
    assert walk.completed_ns * 1e-9 == pytest.approx((10 * 2**0.5 - 0.1) / 0.6, abs=0.2)
    assert np.isnan(walk.control["tau_00_nm"]).all()
    assert np.isnan(walk.control["z_m"]).all()


def test_a_unicycle_on_a_circle_errs_as_pure_pursuit_does_in_steady_state():
    """A chord of l from inside: the robot walks on the circle itself, as the arc through the point is the circle."""
    circle = COURSES["circle"]()
    walk = _walk(circle, _unicycle(circle), FixedLookahead(1.0))
    steady = walk.control["error_m"][100:-200]
    assert steady.max() < 2e-3
    assert walk.control["yaw_rate_radps"][100:-200] == pytest.approx(0.6 / 5, rel=0.02)


def test_a_fall_ends_the_walk_and_is_its_last_tick():
    walk = _walk(BEND, _legged(BEND, DisturbanceSettings(push_n=2000.0, push_s=0.2, push_every_s=0.3)))
    fallen = walk.control["fallen"]
    assert fallen[-1]
    assert not fallen[:-1].any()
    assert walk.completed_ns is None
    assert set(np.diff(walk.control["t_ns"])) == {20_000_000}


def _length_m(course: Course) -> float:
    return float(np.hypot(*np.diff(course.path_m, axis=0).T).sum())


@pytest.mark.parametrize(
    ("name", "length_m", "end", "start_yaw_rad", "speed_mps"),
    [
        ("line", math.hypot(10, 10), (10, 10), math.pi / 4, 0.6),
        ("circle", 10 * math.pi, (0, 0), 0.0, 0.6),
        ("s-curve", 12 + 6 * math.pi, (24, 0), 0.0, 0.5),
    ],
)
def test_courses_are_as_long_and_end_where_the_contract_says(name, length_m, end, start_yaw_rad, speed_mps):
    course = COURSES[name]()
    # Chords are shorter than their arcs, by (spacing / radius)^2 / 24.
    assert _length_m(course) == pytest.approx(length_m, rel=1e-5)
    assert course.path_m[0].tolist() == [0, 0]
    assert course.path_m[-1] == pytest.approx(end, abs=1e-9)
    assert course.start_pose[2] == pytest.approx(start_yaw_rad, abs=SPACING_M / 5)
    assert course.speed_mps == speed_mps
    assert np.hypot(*np.diff(course.path_m, axis=0).T).max() < SPACING_M + 1e-9


def test_a_start_pose_looks_to_the_first_other_point():
    course = Course("own", np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 3.0]]), 0.5)
    assert course.start_pose.tolist() == [1.0, 1.0, pytest.approx(math.pi / 2)]
    assert Course("point", np.array([[1.0, 1.0]]), 0.5).start_pose.tolist() == [1.0, 1.0, 0.0]
