import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.leg_dynamics import (
    LEFT_FORE_RIGHT_HIND,
    RIGHT_FORE_LEFT_HIND,
    diagonal_m,
    diagonal_moment,
)
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.simulation.robot.model import mjcf

FEET = {LEFT_FORE_RIGHT_HIND: (0, 3), RIGHT_FORE_LEFT_HIND: (1, 2)}
pair = st.sampled_from(list(FEET))
size = st.floats(0.05, 1.0)


def crossed(weight, ahead, first, second):
    """Gravity's moment about the line through two points, of three in space: (r x f) along the line."""
    along = (second - first) / np.linalg.norm(second - first)
    about_first = np.cross(np.array([ahead, 0.0, 0.0]) - first, [0.0, 0.0, -weight])
    return (about_first @ along) * along


@given(st.floats(0.1, 5), st.floats(0, 0.2), size, size, st.floats(0.01, 0.2), pair)
def test_eq_8_corrected_in_all_its_parts(leg_kg, behind, length_x, length_y, l1, pair):
    body_kg, g, width = 40.0, 9.81, length_y + 2 * l1
    mgd, d = 4 * leg_kg * g * behind, diagonal_m(length_x, width)
    assert d == pytest.approx((length_x**2 + width**2) ** 0.5)
    moment = diagonal_moment(body_kg * g, -4 * leg_kg * behind / body_kg, length_x, width, pair)
    total = mgd * width / d
    assert np.linalg.norm(moment) == pytest.approx(total, abs=1e-12)
    np.testing.assert_allclose(np.abs(moment), [total * length_x / d, total * width / d, 0], atol=1e-12)


@pytest.mark.parametrize("pair", FEET)
def test_mujocos_centre_of_mass_gives_the_same(pair):
    robot = ROBOTS["foot"]
    model = mujoco.MjModel.from_xml_string(mjcf(robot))
    data = mujoco.MjData(model)
    data.qpos[7:] = robot.standing_joints_rad
    mujoco.mj_forward(model, data)
    centre, weight = data.subtree_com[1] - data.qpos[:3], model.body_mass.sum() * 9.81
    fore, hind = (data.site_xpos[leg] - data.qpos[:3] for leg in FEET[pair])
    length, width = fore[0] - hind[0], abs(fore[1] - hind[1])
    expected = crossed(weight, centre[0], fore, hind)
    np.testing.assert_allclose(diagonal_moment(weight, centre[0], length, width, pair), expected, atol=1e-12)
    assert np.linalg.norm(expected) > 0.1
