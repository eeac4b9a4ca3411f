"""Foot forces that contradict the legs, on a trot by its definition: feet that swing are lifted and bear nothing."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.foot_order import better_foot_order


def trot(n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    phase = np.arange(n)[:, None] / 250 + np.array([0.0, 0.5, 0.5, 0.0])
    lift = np.maximum(np.sin(2 * np.pi * phase), 0.0)
    joints = np.zeros((n, 4, 3))
    joints[..., 1], joints[..., 2] = 0.7 + 0.3 * lift, -1.4 - 0.6 * lift
    noise = np.random.default_rng(0).normal(0, 3, (n, 4))
    return joints.reshape(n, 12).astype(np.float32), (np.where(lift > 0, 0.0, 70.0) + noise).astype(np.float32)


def test_feet_in_their_own_order_are_left_alone() -> None:
    position_rad, force_n = trot()
    assert better_foot_order(position_rad, force_n) is None


@pytest.mark.parametrize("order", [(1, 0, 3, 2), (2, 3, 0, 1)])
def test_swapped_feet_are_found(order: tuple[int, ...]) -> None:
    position_rad, force_n = trot()
    found = better_foot_order(position_rad, force_n[:, order])
    assert found is not None
    # Diagonal feet are alike in a trot: each leg gets a force that is in step with it.
    repaired = force_n[:, order][:, found]
    assert better_foot_order(position_rad, repaired) is None


def test_nothing_is_said_of_a_robot_that_stands_or_has_no_forces() -> None:
    position_rad, force_n = trot()
    assert better_foot_order(position_rad[:50], force_n[:50, ::-1]) is None
    assert better_foot_order(np.tile(position_rad[:1], (500, 1)), force_n[:500]) is None
    assert better_foot_order(position_rad, np.full_like(force_n, np.nan)) is None
