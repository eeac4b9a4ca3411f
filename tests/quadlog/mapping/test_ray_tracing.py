from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.geometry import transform_from_rpy
from quadlog.lidar.classified_scan import PointClass
from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
from quadlog.mapping.grid import window_around
from quadlog.mapping.placing import NO_RAY
from quadlog.messages import PointCloud

WINDOW = window_around(np.zeros(2), 0.1, 201)
SENSOR_M = 0.5


@pytest.fixture
def lowest_rays(scanned, placed):
    """Heights in mm of the lowest rays from origin_m to ends (N, 2) in map; base stands a metre behind the sensor."""

    def look(origin_m, end_m, height_m) -> np.ndarray:
        base_m = origin_m - [1.0, 0.0]
        label = np.where(np.isfinite(height_m), PointClass.GROUND, PointClass.INVALID)
        end_base_m, lidar_m = np.column_stack([end_m - base_m, height_m]), (1.0, 0.0, SENSOR_M)
        return placed(scanned(end_base_m, label, height_m, lidar_m=lidar_m), [*base_m, 0.0], WINDOW).lowest_ray_mm

    return look


def fan(length_m: float, n: int = 4000) -> np.ndarray:
    angle_rad = 2 * np.pi * np.arange(n) / n
    return length_m * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def at(lowest_mm: np.ndarray, x_m: float, y_m: float) -> float:
    col, row = WINDOW.cell_of(np.array([x_m, y_m]))
    return float(lowest_mm[row, col])


def test_rays_to_the_ground_come_down_evenly(lowest_rays) -> None:
    lowest_mm = lowest_rays(np.zeros(2), fan(5.0), np.zeros(4000))
    for way_m in (1.05, 2.55, 4.05):
        assert at(lowest_mm, way_m, 0.0) == pytest.approx(1e3 * SENSOR_M * (1 - way_m / 5), abs=20)
        assert at(lowest_mm, 0.0, -way_m) == pytest.approx(1e3 * SENSOR_M * (1 - way_m / 5), abs=20)
    assert at(lowest_mm, 5.05, 0.0) == NO_RAY, "the cell in which a ray ends is not crossed"
    assert at(lowest_mm, 6.0, 6.0) == NO_RAY


@pytest.mark.parametrize("columns", [1800, 900, 300])
def test_every_cell_in_sight_of_a_sweep_is_crossed(sweep_returns, placed, columns: int) -> None:
    """Also of beams that are tilted, and of a robot that turns while it looks round."""
    scan, middle_ns = sweep_returns(columns, tilt_rad=0.05)
    window = window_around(np.zeros(2), 0.1, 400)
    t_s = middle_ns * 1e-9
    for turn_radps in (0.0, 1.0):
        poses = np.column_stack([0.5 * t_s, np.zeros(len(t_s)), turn_radps * t_s])
        lowest_mm = placed(scan, poses, window, highest_m=5.0).lowest_ray_mm
        rows, cols = np.indices(window.shape)
        centre_m = window.centre_of(np.stack([cols, rows], axis=-1))
        azimuth = np.arctan2(centre_m[..., 1], centre_m[..., 0]) % (2 * np.pi)
        # Where the robot turned on by while the scan lasted, nothing was seen, or twice.
        seam = ((azimuth < 0.2) | (azimuth > 2 * np.pi - 0.1)) & (turn_radps > 0)
        near = np.hypot(*np.moveaxis(centre_m, -1, 0)) < 19.0
        assert (lowest_mm[near & ~seam] < NO_RAY).all()


@pytest.fixture(scope="module")
def sweep_returns():
    """A function that makes a scan of a sweep in which 16 beams all end 20 m away, and its time slots."""

    def make(columns: int, tilt_rad: float):
        azimuth, elevation = np.meshgrid(
            2 * np.pi * (np.arange(columns) + 0.3) / columns, np.deg2rad(np.linspace(-3, 3, 16)), indexing="ij"
        )
        flat = np.cos(elevation)
        beams = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
        ring = np.tile(np.arange(16, dtype=np.uint16), columns)
        offset_ns = np.repeat(np.arange(columns), 16) * 100_000_000 // columns
        cloud = PointCloud(0, "lidar", (20 * beams).reshape(-1, 3).astype(np.float32), ring, offset_ns)
        mount = transform_from_rpy(np.array([0.0, 0.0, 1.2]), tilt_rad, 0.0, 0.0)
        returns = ScanClassifier(RangeImageSettings()).classify(cloud, mount)
        assert returns.route == "rings"
        return returns, returns.slot_ns

    return make


def test_one_short_ray_holds_back_its_sector(lowest_rays) -> None:
    """A cell is free only where all that looked that way agree."""
    long_m, short_m = fan(6.0), fan(2.0)[:40:4]
    end_m = np.concatenate([short_m, long_m])
    height_m = np.concatenate([np.full(len(short_m), SENSOR_M * (1 - 2 / 6)), np.zeros(len(long_m))])
    lowest_mm = lowest_rays(np.zeros(2), end_m, height_m)
    assert at(lowest_mm, 4.05, 0.08) == NO_RAY
    assert at(lowest_mm, 0.08, 4.05) < NO_RAY


@given(st.integers(0, 2**32), st.floats(-3, 3), st.floats(-3, 3), st.floats(-4, 4))
def test_a_cell_called_crossed_has_a_ray_through_its_neighbourhood(
    scanned, placed, seed: int, x_m: float, y_m: float, yaw_rad: float
) -> None:
    """Against sampling every ray: no cell is crossed that no ray of its sector passed, none below the lowest."""
    random = np.random.default_rng(seed)
    end_base_m, height_m = random.uniform(-8, 8, (40, 2)), random.uniform(0, 1, 40)
    # What is in the robot's own body ends no ray.
    end_base_m = end_base_m[np.abs(end_base_m).max(axis=1) > 0.5]
    height_m = height_m[: len(end_base_m)]
    scan = scanned(np.column_stack([end_base_m, height_m]), PointClass.GROUND, height_m, lidar_m=(0, 0, SENSOR_M))
    lowest_mm = placed(scan, [x_m, y_m, yaw_rad], WINDOW, highest_m=30.0).lowest_ray_mm
    rows, cols = np.nonzero(lowest_mm < NO_RAY)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    way = end_base_m @ np.array([[cos, sin], [-sin, cos]])
    centre_m = WINDOW.centre_of(np.column_stack([cols, rows])) - np.array([x_m, y_m])
    share = np.clip((centre_m @ way.T) / (way**2).sum(axis=1), 0, 1)  # (cells, rays)
    off_m = np.linalg.norm(centre_m[:, None] - share[..., None] * way, axis=2)
    # A sector of a scan with few rays, where it is widest.
    near = off_m < 0.1 + 0.125 * np.linalg.norm(centre_m, axis=1)[:, None]
    assert near.any(axis=1).all()
    passed_m = np.where(near, SENSOR_M + share * (height_m - SENSOR_M), np.inf).min(axis=1)
    assert (lowest_mm[rows, cols] * 1e-3 >= passed_m - 0.35).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_invalid_ray_ends_cross_no_cells(scanned, placed, bad: float) -> None:
    ends_m = [[bad, 0.0, 0.0], [0.0, bad, 0.0], [bad, bad, 0.0], [0.0, 0.0, 0.0]]
    for end_m, height_m in [(ends_m, np.zeros(4)), ([[5.0, 0.0, 0.0]], [np.nan]), (np.empty((0, 3)), [])]:
        scan = scanned(end_m, PointClass.GROUND, height_m)
        assert (placed(scan, np.zeros(3), WINDOW).lowest_ray_mm == NO_RAY).all()
