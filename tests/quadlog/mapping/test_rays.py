from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.mapping.rays import lowest_rays as lowest_rays_from_base
from quadlog.mapping.window import Window, window_around

WINDOW = window_around(np.zeros(2), 0.1, 201)
SENSOR_M = 0.5


def lowest_rays(origin_m, sensor_m, end_m, height_m, window, yaw_rad: float = 0.0) -> np.ndarray:
    """Given in map; base stands a metre behind the sensor and is turned by yaw_rad."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    rotation_base_to_map = np.array([[cos, -sin], [sin, cos]])
    base_m = origin_m - rotation_base_to_map @ [1.0, 0.0]
    end_base_m = np.column_stack([(end_m - base_m) @ rotation_base_to_map, np.zeros(len(end_m))])
    pose = np.array([*base_m, yaw_rad])
    return lowest_rays_from_base(np.array([1.0, 0.0, sensor_m]), end_base_m, height_m, pose, window)


def fan(length_m: float, n: int = 4000) -> np.ndarray:
    angle_rad = 2 * np.pi * np.arange(n) / n
    return length_m * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def crossed_at(lowest_m: np.ndarray, x_m: float, y_m: float) -> float:
    col, row = WINDOW.cell_of(np.array([x_m, y_m]))
    return float(lowest_m[row, col])


def test_rays_to_the_ground_come_down_evenly() -> None:
    end_m = fan(5.0)
    lowest_m = lowest_rays(np.zeros(2), SENSOR_M, end_m, np.zeros(len(end_m)), WINDOW)
    for way_m in (1.05, 2.55, 4.05):
        assert crossed_at(lowest_m, way_m, 0.0) == pytest.approx(SENSOR_M * (1 - way_m / 5), abs=0.02)
        assert crossed_at(lowest_m, 0.0, -way_m) == pytest.approx(SENSOR_M * (1 - way_m / 5), abs=0.02)
    assert np.isinf(crossed_at(lowest_m, 5.05, 0.0)), "the cell in which a ray ends is not crossed"
    assert np.isinf(crossed_at(lowest_m, 6.0, 6.0))


def test_every_cell_nearer_than_all_ends_is_crossed() -> None:
    end_m = fan(6.0)
    lowest_m = lowest_rays(np.zeros(2), SENSOR_M, end_m, np.zeros(len(end_m)), WINDOW)
    rows, cols = np.indices(WINDOW.shape)
    centre_m = WINDOW.centre_of(np.stack([cols, rows], axis=-1))
    near = np.hypot(centre_m[..., 0], centre_m[..., 1]) < 5.5
    assert np.isfinite(lowest_m[near]).mean() > 0.995, "lines through sectors may miss the corner of a cell"
    assert np.isinf(lowest_m[np.hypot(centre_m[..., 0], centre_m[..., 1]) > 6.2]).all()


def test_the_lower_of_two_rays_counts_until_it_ends() -> None:
    near_m, far_m = fan(2.0), fan(8.0)
    end_m, height_m = np.concatenate([near_m, far_m]), np.zeros(8000)
    lowest_m = lowest_rays(np.zeros(2), SENSOR_M, end_m, height_m, WINDOW)
    assert crossed_at(lowest_m, 1.55, 0.0) == pytest.approx(SENSOR_M * (1 - 1.55 / 2), abs=0.02)
    assert crossed_at(lowest_m, 3.05, 0.0) == pytest.approx(SENSOR_M * (1 - 3.05 / 8), abs=0.02)


def test_what_stands_behind_an_obstacle_is_not_seen() -> None:
    wall_m = np.column_stack([np.full(3000, 3.0), np.linspace(-3, 3, 3000)])
    lowest_m = lowest_rays(np.zeros(2), SENSOR_M, wall_m, np.full(3000, 0.4), WINDOW)
    assert np.isfinite(crossed_at(lowest_m, 2.85, 0.0))
    assert np.isinf(crossed_at(lowest_m, 3.25, 0.0))


def test_one_short_ray_holds_back_its_sector() -> None:
    """A cell is free only where all that looked that way agree."""
    long_m, short_m = fan(6.0), fan(2.0)[:40:4]
    end_m = np.concatenate([long_m, short_m])
    height_m = np.concatenate([np.zeros(len(long_m)), np.full(len(short_m), SENSOR_M * (1 - 2 / 6))])
    lowest_m = lowest_rays(np.zeros(2), SENSOR_M, end_m, height_m, WINDOW)
    assert np.isinf(crossed_at(lowest_m, 4.05, 0.08))
    assert np.isfinite(crossed_at(lowest_m, 0.08, 4.05))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32), st.floats(-3, 3), st.floats(-3, 3), st.floats(-4, 4))
def test_a_cell_called_crossed_has_a_ray_through_its_neighbourhood(
    seed: int, x_m: float, y_m: float, yaw_rad: float
) -> None:
    """Against sampling every ray: no cell is crossed that no ray of its sector passed, none below the lowest."""
    rng = np.random.default_rng(seed)
    origin_m = np.array([x_m, y_m])
    end_m, height_m = rng.uniform(-8, 8, (40, 2)), rng.uniform(0, 1, 40)
    lowest_m = lowest_rays(origin_m, SENSOR_M, end_m, height_m, WINDOW, yaw_rad)
    rows, cols = np.nonzero(np.isfinite(lowest_m))
    centre_m = WINDOW.centre_of(np.column_stack([cols, rows]))
    way = end_m - origin_m
    for at, lowest in zip(centre_m - origin_m, lowest_m[rows, cols], strict=True):
        share = np.clip((way @ at) / (way**2).sum(axis=1), 0, 1)
        off_m = np.linalg.norm(at - share[:, None] * way, axis=1)
        near = off_m < 0.1 + 0.125 * np.linalg.norm(at)  # a sector of a scan with few rays, where it is widest
        assert near.any()
        assert lowest >= (SENSOR_M + share * (height_m - SENSOR_M))[near].min() - 0.35


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_ends_that_are_nowhere_cross_nothing(bad: float) -> None:
    end_m = np.array([[bad, 0.0, 0.0], [0.0, bad, 0.0], [bad, bad, 0.0], [0.0, 0.0, 0.0]])
    sensor_m = np.array([0.0, 0.0, SENSOR_M])
    assert np.isinf(lowest_rays_from_base(sensor_m, end_m, np.zeros(4), np.zeros(3), WINDOW)).all()
    ahead_m = np.array([[5.0, 0.0, 0.0]])
    assert np.isinf(lowest_rays_from_base(sensor_m, ahead_m, np.array([np.nan]), np.zeros(3), WINDOW)).all()
    assert np.isinf(lowest_rays(np.zeros(2), SENSOR_M, np.empty((0, 2)), np.empty(0), WINDOW)).all()


@pytest.mark.parametrize("times", [2, 10])
def test_rays_without_a_return_change_nothing_about_the_others(times: int) -> None:
    """Some drivers send them as NaN, others leave them out."""
    end_m = fan(5.0, 1500)
    sparse_m, sparse_height_m = np.full((1500 * times, 2), np.nan), np.full(1500 * times, np.nan)
    sparse_m[::times], sparse_height_m[::times] = end_m, 0.0
    expected = lowest_rays(np.zeros(2), SENSOR_M, end_m, np.zeros(1500), WINDOW)
    assert np.array_equal(lowest_rays(np.zeros(2), SENSOR_M, sparse_m, sparse_height_m, WINDOW), expected)


def test_a_sensor_outside_the_window_crosses_nothing_in_it() -> None:
    window = Window(500, 500, 0.1, (20, 20))
    end_m = fan(100.0)
    assert np.isinf(lowest_rays(np.zeros(2), SENSOR_M, end_m, np.zeros(len(end_m)), window)).all()
