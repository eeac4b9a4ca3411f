"""Geometry written a second time, in closed form: what the simulated sensors are held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.simulation.sensors.scene import Box, Obstacle
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import SynthesizedRecording

Distance = Callable[[Float], Float]


def signed_distance(obstacle: Obstacle, points_m: Float) -> Float:
    """(N,) distance of points (N, 3) to an obstacle's surface on flat ground, negative inside."""
    offset = points_m[:, :2] - [obstacle.x_m, obstacle.y_m]
    if isinstance(obstacle, Box):
        turn = np.exp(-1j * obstacle.yaw_rad) * (offset[:, 0] + 1j * offset[:, 1])
        across = [np.abs(turn.real) - obstacle.length_m / 2, np.abs(turn.imag) - obstacle.width_m / 2]
    else:
        across = [np.hypot(*offset.T) - obstacle.radius_m]
    middle_m, half_m = (obstacle.height_m + obstacle.bottom_m) / 2, (obstacle.height_m - obstacle.bottom_m) / 2
    outside = np.stack([*across, np.abs(points_m[:, 2] - middle_m) - half_m])
    return np.linalg.norm(np.maximum(outside, 0.0), axis=0) + np.minimum(outside.max(axis=0), 0.0)


@pytest.fixture
def distance_to() -> Callable[[Obstacle], Distance]:
    return lambda obstacle: lambda points_m: signed_distance(obstacle, points_m)


@pytest.fixture
def distance_to_yard() -> Distance:
    """(N,) unsigned distance of points (N, 3) to the ground or the nearest surface of the scenario's obstacles."""

    def nearest(points_m: Float) -> Float:
        distances = [np.abs(signed_distance(obstacle, points_m)) for obstacle in follow.OBSTACLES]
        return np.min([*distances, np.abs(points_m[:, 2])], axis=0)

    return nearest


@pytest.fixture(scope="session")
def short() -> SynthesizedRecording:
    """One second with thin scans."""
    return follow.synthesize(seed=3, duration_s=1.0, azimuth_steps=90)
