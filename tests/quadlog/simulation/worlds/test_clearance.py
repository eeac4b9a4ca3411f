from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.simulation.worlds.world import body_clearance, occupied_centres


def test_distances_from_the_sides_and_a_corner():
    def clearance(x, y):
        return body_clearance(0.0, 0.0, 0.0, 0.6, 0.2, np.array([[x, y]]), 0.1)

    assert clearance(1.0, 0.0) == pytest.approx(0.65)
    assert clearance(0.0, -0.5) == pytest.approx(0.35)
    assert clearance(0.6, 0.5) == pytest.approx(0.5 - 0.05)
    assert clearance(0.2, 0.05) == pytest.approx(-0.05)


def test_turning_the_robot_is_turning_the_world():
    rng = np.random.default_rng(0)
    cells = rng.uniform(-2, 2, (20, 2))
    yaw = 0.8
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    moved = cells @ turn.T + [3.0, -1.0]
    assert body_clearance(3.0, -1.0, yaw, 0.6, 0.2, moved, 0.1) == pytest.approx(
        body_clearance(0.0, 0.0, 0.0, 0.6, 0.2, cells, 0.1)
    )


def test_without_obstacles_it_is_infinite():
    window = Window(3, -2, 0.5, (4, 6))
    occupied = np.zeros((4, 6), dtype=bool)
    assert body_clearance(0.0, 0.0, 0.0, 0.6, 0.2, occupied_centres(occupied, window), 0.5) == math.inf
    occupied[1, 2] = True
    np.testing.assert_allclose(occupied_centres(occupied, window), [[2.75, -0.25]])
