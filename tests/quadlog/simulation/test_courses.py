from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.simulation.course_walk import COURSES, SPACING_M, Course


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


def test_the_circle_has_its_radius_and_lies_to_the_left():
    path_m = COURSES["circle"]().path_m
    assert np.hypot(*(path_m - [0, 5]).T) == pytest.approx(np.full(len(path_m), 5.0))
    assert path_m[1, 1] > 0


def test_the_s_curve_bends_left_right_left_by_3_m_without_a_kink():
    path_m = COURSES["s-curve"]().path_m
    steps = np.diff(path_m, axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    curvature = np.diff(heading) / np.hypot(*steps[1:].T)
    assert np.abs(curvature).max() == pytest.approx(1 / 3, rel=1e-3)
    assert np.diff(np.sign(curvature[np.abs(curvature) > 0.3])).nonzero()[0].size == 2
    assert heading.max() == pytest.approx(math.pi / 2, abs=0.01)
    assert heading.min() == pytest.approx(-math.pi / 2, abs=0.01)
    assert path_m[:, 1].max() == pytest.approx(6.0, abs=1e-3)


def test_a_start_pose_looks_to_the_first_other_point():
    course = Course("own", np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 3.0]]), 0.5)
    assert course.start_pose.tolist() == [1.0, 1.0, pytest.approx(math.pi / 2)]
    assert Course("point", np.array([[1.0, 1.0]]), 0.5).start_pose.tolist() == [1.0, 1.0, 0.0]
