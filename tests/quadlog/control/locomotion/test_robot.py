import numpy as np
import pytest

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.control.locomotion.robot import ROBOTS, SIDES


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


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))
def test_it_stands_on_four_feet_as_high_as_it_says(robot):
    feet = np.empty((4, 3))
    foot_positions(robot.standing_joints_rad, robot.hips_m, robot.lengths, feet)
    np.testing.assert_allclose(feet[:, 2], robot.foot_radius_m - robot.standing_height_m, atol=1e-14)
    np.testing.assert_allclose(feet[:, 0], robot.hips_m[:, 0], atol=1e-14)
    np.testing.assert_allclose(feet[:, 1], SIDES * (robot.hip_y_m + robot.lengths_m[0]), atol=1e-14)
