from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.simulation.robot.trot import draw_trot

ROBOT = ROBOTS["foot"]


@given(st.integers(0, 2**31 - 1))
def test_all_is_within_its_spread_and_a_seed_draws_the_same_again(seed):
    draw, again = (draw_trot(seed, 0.25, 0.1, 0.02) for _ in range(2))
    assert abs(draw.friction_share) <= 0.25
    assert abs(draw.radius_share) <= 0.1
    assert np.abs(draw.postures_rad).max() <= 0.02
    assert (draw.friction_share, draw.radius_share) == (again.friction_share, again.radius_share)
    np.testing.assert_array_equal(draw.postures_rad, again.postures_rad)


def test_many_seeds_fill_their_spreads():
    draws = [draw_trot(seed, 0.25, 0.1, 0.02) for seed in range(200)]
    friction, radius = (
        np.array([getattr(draw, name) for draw in draws]) for name in ("friction_share", "radius_share")
    )
    postures = np.array([draw.postures_rad for draw in draws])
    for values, spread in ((friction, 0.25), (radius, 0.1), (postures, 0.02)):
        assert abs(values.mean()) < 0.15 * spread
        assert values.max() > 0.95 * spread
        assert values.min() < -0.95 * spread


def test_the_other_pair_starts_from_the_mirrored_posture():
    draw = draw_trot(5, 0.25, 0.1, 0.02)
    feet = np.empty((2, 4, 3))
    for pair in (0, 1):
        foot_positions(ROBOT.standing_joints_rad + draw.of_pair(pair), ROBOT.hips_m, ROBOT.lengths, feet[pair])
    np.testing.assert_allclose(feet[1], feet[0, [1, 0, 3, 2]] * [1, -1, 1], atol=1e-15)
    assert not np.allclose(feet[1], feet[0])
