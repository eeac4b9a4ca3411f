"""What all scenarios share: nobody walks into anything, the robot stays behind the person, sight is lost at times."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from quadlog.simulation.synthetic import SCENARIOS

# A whole way round in each.
LAP_S = np.arange(0.0, 100.0, 0.1)
each_scenario = pytest.mark.parametrize("name", SCENARIOS)


def synthesize(name, seed, duration_s=1.0):
    return import_module(SCENARIOS[name]).synthesize(seed=seed, duration_s=duration_s, azimuth_steps=16)


@each_scenario
@pytest.mark.parametrize("seed", range(2))
def test_robot_and_people_keep_clear_of_obstacles_and_of_each_other(name, seed, distance_to):
    site = synthesize(name, seed).site
    for walk, room_m in ((site.robot, 0.42), (site.person, 0.4), (site.passer_by, 0.3)):
        xy = walk.at(LAP_S).position_m
        points = np.concatenate([np.column_stack([xy, np.full(len(xy), z)]) for z in (0.1, 0.4, 1.5)])
        assert min(distance_to(each)(points).min() for each in site.obstacles + site.foliage) > room_m
    robot, person, other = (walk.at(LAP_S) for walk in (site.robot, site.person, site.passer_by))
    apart_m = np.linalg.norm(robot.position_m - person.position_m, axis=1)
    assert 1.3 < apart_m.min() < apart_m.max() < 2.6
    assert min(np.linalg.norm(other.position_m - each.position_m, axis=1).min() for each in (robot, person)) > 0.8
    assert np.abs(robot.yaw_rate_radps).max() < 1.5


@each_scenario
def test_sites_depend_on_the_seed(name):
    one, same, other = (synthesize(name, seed).site for seed in (3, 3, 4))
    assert (one.obstacles, one.foliage) == (same.obstacles, same.foliage)
    np.testing.assert_array_equal(one.terrain.height_m, same.terrain.height_m)
    np.testing.assert_array_equal(one.robot.at(LAP_S).position_m, same.robot.at(LAP_S).position_m)
    # The yard is always the same, the building too; what grows and what stands about is drawn.
    assert (one.obstacles != other.obstacles) == (name != "follow")
    is_same_way = np.array_equal(one.robot.at(LAP_S).position_m, other.robot.at(LAP_S).position_m)
    assert is_same_way == (name != "forest")


@pytest.mark.parametrize("name", ["follow", "forest"])
def test_sight_to_the_anchors_is_lost_at_times_and_kept_mostly(name):
    for ranges in synthesize(name, 0, duration_s=12.0).ranges:
        assert 0.1 < 1 - ranges.line_of_sight.mean() < 0.5
        assert ranges.line_of_sight.sum(axis=1).min() >= 1
