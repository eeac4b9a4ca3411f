import pytest

from quadlog.control.locomotion.robot import ROBOTS


def test_masses_and_sizes_are_those_of_the_papers():
    tracking, following, foot = ROBOTS["tracking"], ROBOTS["following"], ROBOTS["foot"]
    assert [round(robot.mass_kg, 9) for robot in (tracking, following, foot)] == [12.786, 15.0, 10.0]
    assert tracking.trunk_m == (0.267, 0.194, 0.114)
    assert tracking.lengths_m == (0.075, 0.22, 0.22)
    assert following.torque_limit_nm == 48
    assert following.trunk_m[0] == 0.62
    assert 2 * (following.hip_y_m + following.lengths_m[0]) == pytest.approx(0.26)
    assert following.standing_height_m + following.trunk_m[2] / 2 == pytest.approx(0.37)
    assert foot.lengths_m == (0.07, 0.21, 0.21)
    assert foot.standing_height_m == 0.2
    assert sum(foot.link_masses_kg) == pytest.approx(0.4)
