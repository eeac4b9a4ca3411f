from __future__ import annotations

import numpy as np
import pytest

from quadlog.lidar.ground_labels import SECTOR_COLUMNS, GroundProfile, level_plane, profile_height

COLUMNS, SECTORS = 4 * SECTOR_COLUMNS, 4


def ground_profile(ground, distance_m, z_m, floor_m, plane=(0.0, 0.0, 0.0)) -> GroundProfile:
    profile = GroundProfile(*ground.shape)
    profile.fit(ground.astype(np.int8), distance_m, z_m, floor_m, np.array(plane), np.eye(4))
    return profile


def height_at(profile: GroundProfile, column: int, distance_m: float) -> float:
    table = profile.height_m.reshape(-1), profile.first, profile.second, profile.across
    return float(profile_height(*table, column, np.float32(distance_m)))


def test_heights_lie_on_lines_through_the_ground_and_go_on_with_the_plane() -> None:
    ground = np.ones((2, COLUMNS), dtype=np.bool_)
    distance_m = np.repeat(np.array([[2.0], [4.0]], dtype=np.float32), COLUMNS, axis=1)
    z_m = np.repeat(np.array([[0.2], [1.0]], dtype=np.float32), COLUMNS, axis=1)
    profile = ground_profile(ground, distance_m, z_m, 0.0)
    heights = [height_at(profile, column, d) for column in (0, 17, COLUMNS - 1) for d in (0, 1, 2, 3, 4, 6, 30)]
    assert heights == pytest.approx([0, 0.1, 0.2, 0.6, 1.0, 1.0, 1.0] * 3, abs=1e-5)


def test_without_ground_there_is_the_floor_and_its_slope() -> None:
    nothing = np.zeros((2, COLUMNS), dtype=np.float32)
    profile = ground_profile(nothing > 0, nothing, nothing, -0.5, (0.1, 0.05, 0.0))
    middle = SECTOR_COLUMNS // 2
    found = [height_at(profile, middle + SECTOR_COLUMNS * s - 1, 10.0) for s in range(SECTORS)]
    diagonal_m = 10 / np.sqrt(2)
    rise_m = diagonal_m * np.array([0.15, -0.05, -0.15, 0.05])
    assert found == pytest.approx(rise_m - 0.5, abs=0.15)


def test_a_sector_in_the_shadow_borrows_from_those_beside_it() -> None:
    ground = np.ones((1, COLUMNS), dtype=np.bool_)
    ground[:, SECTOR_COLUMNS : 2 * SECTOR_COLUMNS] = False
    distance_m = np.full((1, COLUMNS), 4.0, dtype=np.float32)
    profile = ground_profile(ground, distance_m, 0.1 * distance_m, 0.0)
    assert height_at(profile, SECTOR_COLUMNS + 8, 4.0) == pytest.approx(0.4)


def test_plane_agrees_with_least_squares() -> None:
    random = np.random.default_rng(0)
    x_m, y_m = random.uniform(-10, 10, (2, 800))
    z_m = 0.2 * x_m - 0.1 * y_m + 0.3 + random.normal(0, 0.01, 800)
    lidar_xy_m = np.array([0.5, -1.0])
    places = [each.astype(np.float32) for each in (x_m - 0.5, y_m + 1.0, z_m)]
    plane = level_plane(np.ones((2, 400), np.int8), *places, lidar_xy_m)
    assert plane == pytest.approx([0.2, -0.1, 0.3], abs=0.005)
    assert level_plane(np.zeros((2, 400), np.int8), *places, lidar_xy_m).tolist() == [0, 0, 0]
