from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.synthetic import follow

ROBOT_M = (0.62, 0.26)


@pytest.fixture(scope="module")
def lap():
    """The site, and instants that cover a whole way round."""
    recording = follow.synthesize(seed=0, duration_s=12.0, azimuth_steps=16)
    return recording.site, np.arange(0.0, 95.0, 0.05)


def body(motion, length_m, width_m):
    """(N, 12, 3) points on the outline of a rectangle that walks."""
    edge = np.linspace(-0.5, 0.5, 4)
    outline = [(x, y) for x in edge for y in edge if 0.5 in (abs(x), abs(y))]
    turned = (
        np.array([length_m * x + 1j * width_m * y for x, y in outline])[None] * np.exp(1j * motion.yaw_rad)[:, None]
    )
    points = turned + (motion.position_m @ [1, 1j])[:, None]
    return np.stack([points.real, points.imag, np.full(points.shape, 0.2)], axis=-1)


def test_robot_and_people_never_touch_an_obstacle(lap, distance_to):
    site, t_s = lap
    for walk, size, room_m in (
        (site.robot, ROBOT_M, 0.3),
        (site.person, (0.5, 0.5), 0.2),
        (site.passer_by, (0.5, 0.5), 0.2),
    ):
        points = body(walk.at(t_s), *size).reshape(-1, 3)
        for obstacle in site.obstacles:
            assert distance_to(obstacle)(points).min() > room_m, (walk, obstacle)


def test_robot_follows_about_two_metres_behind_and_inside_the_map_window(lap):
    site, t_s = lap
    robot, person, other = (walk.at(t_s) for walk in (site.robot, site.person, site.passer_by))
    apart = np.linalg.norm(robot.position_m - person.position_m, axis=1)
    assert apart.min() > 1.3
    assert apart.max() < 2.6
    assert ((robot.speed_mps > 0.55) & (robot.speed_mps < 0.85)).all()
    assert ((person.speed_mps > 0.6) & (person.speed_mps < 0.8)).all()
    assert np.abs(robot.yaw_rate_radps).max() < 1.5
    for walker in (robot, person):
        assert np.linalg.norm(other.position_m - walker.position_m, axis=1).min() > 1.0


def test_the_way_to_the_person_is_at_times_not_straight(lap, distance_to):
    """Within the fixture's 12 s the straight line, with the papers' 0.3 m of room, runs into something."""
    site, t_s = lap
    t_s = t_s[t_s < 12.0]
    robot, person = site.robot.at(t_s).position_m, site.person.at(t_s).position_m
    along = np.linspace(0, 1, 60)[:, None, None]
    line = robot + along * (person - robot)
    line = np.concatenate([line, np.full((*line.shape[:2], 1), 0.2)], axis=2).reshape(-1, 3)
    room = np.min([distance_to(obstacle)(line) for obstacle in site.obstacles], axis=0).reshape(60, -1).min(axis=0)
    assert np.mean(room < 0.3) > 0.2


def test_sight_to_the_anchors_is_lost_at_times_and_kept_mostly():
    recording = follow.synthesize(seed=0, duration_s=12.0, azimuth_steps=16)
    for ranges in recording.ranges:
        assert 0.1 < 1 - ranges.line_of_sight.mean() < 0.35
        assert ranges.line_of_sight.sum(axis=1).min() >= 1


def test_anchors_are_not_all_at_one_height():
    assert np.ptp(follow.ANCHORS_M[:, 2]) > 0.05
    assert len(follow.ANCHORS_M) >= 3
