from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import GroundPlane, PointClass
from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
from quadlog.mapping.grid import window_around
from quadlog.mapping.placing import NO_RAY, NO_TOP
from quadlog.messages import PointCloud

WINDOW = window_around(np.zeros(2), 0.1, 401)
SENSOR_M = 0.5


def cells(xy_m) -> set[tuple[int, int]]:
    return set(map(tuple, WINDOW.cell_of(np.asarray(xy_m)).tolist()))


def hit(top_mm: np.ndarray) -> set[tuple[int, int]]:
    return set(map(tuple, np.argwhere(top_mm > NO_TOP)[:, ::-1].tolist()))


@given(st.integers(0, 2**32), st.floats(-3, 3), st.floats(-1, 1), st.floats(-1.5, 1.5))
def test_cells_are_hit_where_the_pose_of_their_time_puts_points_and_nowhere_else(
    scanned, placed, seed, yaw_rad, speed, turn
) -> None:
    random = np.random.default_rng(seed)
    xy_m, slot = random.uniform(-8, 8, (400, 2)), random.integers(0, 32, 400)
    xy_m = xy_m[np.abs(xy_m).max(axis=1) > 1.0]
    slot, z_m = slot[: len(xy_m)], random.uniform(-0.5, 2, len(xy_m))
    t_s = (np.arange(32) + 0.5) * 0.1 / 32
    poses = np.column_stack([3 + speed * t_s, -2 * t_s, yaw_rad + turn * t_s])
    base_to_map = [transform_from_rpy(np.array([x, y, 0]), 0, 0, yaw) for x, y, yaw in poses]
    places = [apply_transform(base_to_map[s], np.array([[*at, 0]])) for s, at in zip(slot, xy_m, strict=True)]
    true_m = np.concatenate(places)[:, :2]
    top_mm = placed(scanned(np.column_stack([xy_m, z_m]), slot=slot), poses, WINDOW).top_mm
    blocks = (z_m >= 0.05) & (z_m <= 1.5)
    # float32 may put a point that lies on an edge into the next cell.
    clear = np.abs((true_m / 0.1) % 1 - 0.5).max(axis=1) < 0.4999
    on_edges = cells(true_m[blocks & ~clear] + 1e-5) | cells(true_m[blocks & ~clear] - 1e-5)
    assert cells(true_m[blocks & clear]) <= hit(top_mm) <= cells(true_m[blocks & clear]) | on_edges
    if clear.all():
        at = WINDOW.cell_of(true_m[blocks])
        highest = np.full(WINDOW.shape, -np.inf)
        np.maximum.at(highest, (at[:, 1], at[:, 0]), 1e3 * z_m[blocks])
        assert top_mm[top_mm > NO_TOP] == pytest.approx(highest[top_mm > NO_TOP], abs=1)


@pytest.mark.parametrize(
    ("min_points", "has_ground", "n_hit"), [(1, True, 2), (3, True, 1), (4, True, 0), (1, False, 2), (4, False, 2)]
)
def test_a_cell_needs_its_points(scanned, placed, min_points, has_ground, n_hit) -> None:
    """But not in a scan without ground: of a wall, a 2-D scanner sees a point a cell."""
    points = [[2.051, 0.051, 0.3], [2.052, 0.051, 0.3], [2.053, 0.051, 0.3], [2.15, 0.05, 0.4], [3.0, 3.0, 0.0]]
    label = [PointClass.OBSTACLE] * 4 + [PointClass.GROUND if has_ground else PointClass.OUTLIER]
    assert len(hit(placed(scanned(points, label), np.zeros(3), WINDOW, min_points=min_points).top_mm)) == n_hit


def test_neither_a_wall_taken_for_the_ground_nor_the_robots_own_body_nor_the_target_blocks(scanned, placed) -> None:
    unit = np.array([-1, 0, 0.05]) / np.hypot(1, 0.05)
    scan = scanned([[2.0, 0, 0.5], [4.0, 1.0, 1.0], [5.5, -1.0, 0.3]], ground=GroundPlane(unit, -6 * unit[0]))
    assert len(hit(placed(scan, np.zeros(3), WINDOW).top_mm)) == 3
    inside = [[0.40, 0.0, 0.3], [-0.40, 0.22, 0.3], [0.0, -0.22, 0.1]]
    outside = [[0.42, 0.0, 0.3], [0.0, 0.24, 0.3]]
    assert hit(placed(scanned(inside + outside), np.zeros(3), WINDOW).top_mm) == cells(np.array(outside)[:, :2])
    assert (placed(scanned(inside), np.zeros(3), WINDOW).lowest_ray_mm == NO_RAY).all(), "nor ends rays"
    target = scanned([[3.0, 0.0, 1.0], [3.0, 0.45, 1.0], [3.0, 0.55, 1.0]])
    top_mm = placed(target, np.array([1.0, 1.0, np.pi / 2]), WINDOW, (1.0, 4.0)).top_mm
    assert hit(top_mm) == cells([[0.45, 4.0]])


def fan(length_m: float, height_m: float, n: int = 4000) -> np.ndarray:
    """Ends (N, 3) all round from the sensor, which stands a metre before base."""
    angle_rad = 2 * np.pi * np.arange(n) / n
    return np.column_stack([1 + length_m * np.cos(angle_rad), length_m * np.sin(angle_rad), np.full(n, height_m)])


def test_rays_to_the_ground_come_down_evenly_and_one_short_ray_holds_back_its_sector(scanned, placed) -> None:
    """A cell is free only where all that looked that way agree."""

    def at(x_m: float, y_m: float) -> float:
        col, row = WINDOW.cell_of(np.array([x_m, y_m]))
        return float(lowest_mm[row, col])

    pose, lidar_m = [-1.0, 0.0, 0.0], (1.0, 0.0, SENSOR_M)
    lowest_mm = placed(scanned(fan(5, 0), PointClass.GROUND, lidar_m=lidar_m), pose, WINDOW).lowest_ray_mm
    for way_m in (1.05, 2.55, 4.05):
        assert [at(way_m, 0), at(0, -way_m)] == pytest.approx([1e3 * SENSOR_M * (1 - way_m / 5)] * 2, abs=20)
    assert at(5.05, 0.0) == at(6.0, 6.0) == NO_RAY, "the cell in which a ray ends is not crossed"
    ends_m = np.concatenate([fan(2, SENSOR_M * (1 - 2 / 6))[:40:4], fan(6, 0)])
    lowest_mm = placed(scanned(ends_m, PointClass.GROUND, lidar_m=lidar_m), pose, WINDOW).lowest_ray_mm
    assert at(0.08, 4.05) < at(4.05, 0.08) == NO_RAY


@pytest.mark.parametrize("columns", [1800, 900, 300])
def test_every_cell_in_sight_of_a_sweep_is_crossed(placed, columns: int) -> None:
    """16 beams that all end 20 m away, also tilted, and of a robot that turns while it looks round."""
    azimuth, elevation = np.meshgrid(
        2 * np.pi * (np.arange(columns) + 0.3) / columns, np.deg2rad(np.linspace(-3, 3, 16)), indexing="ij"
    )
    flat = np.cos(elevation)
    beams = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    ring, offset_ns = np.tile(np.arange(16, dtype=np.uint16), columns), np.arange(16 * columns) // 16 * 10**8 // columns
    mount = transform_from_rpy(np.array([0.0, 0.0, 1.2]), 0.05, 0.0, 0.0)
    cloud = PointCloud(0, "lidar", (20 * beams).astype(np.float32), ring, offset_ns)
    scan = ScanClassifier(RangeImageSettings()).classify(cloud, mount)
    assert scan.route == "rings"
    centre_m = WINDOW.centre_of(np.moveaxis(np.indices(WINDOW.shape)[::-1], 0, -1))
    azimuth, t_s = np.arctan2(centre_m[..., 1], centre_m[..., 0]) % (2 * np.pi), scan.slot_ns * 1e-9
    for turn_radps in (0.0, 1.0):
        poses = np.column_stack([0.5 * t_s, np.zeros(len(t_s)), turn_radps * t_s])
        lowest_mm = placed(scan, poses, WINDOW, highest_m=5.0).lowest_ray_mm
        # Where the robot turned on by while the scan lasted, nothing was seen, or twice.
        seam = ((azimuth < 0.2) | (azimuth > 2 * np.pi - 0.1)) & (turn_radps > 0)
        assert (lowest_mm[(np.hypot(*np.moveaxis(centre_m, -1, 0)) < 19.0) & ~seam] < NO_RAY).all()


@given(st.integers(0, 2**32), st.floats(-3, 3), st.floats(-3, 3), st.floats(-4, 4))
def test_a_cell_called_crossed_has_a_ray_through_its_neighbourhood(
    scanned, placed, seed: int, x_m: float, y_m: float, yaw_rad: float
) -> None:
    """Against sampling every ray: no cell is crossed that no ray of its sector passed, none below the lowest."""
    random = np.random.default_rng(seed)
    ends_m = np.column_stack([random.uniform(-8, 8, (40, 2)), random.uniform(0, 1, 40)])
    # What is in the robot's own body ends no ray.
    ends_m = ends_m[np.abs(ends_m[:, :2]).max(axis=1) > 0.5]
    lowest_mm = placed(scanned(ends_m, PointClass.GROUND), [x_m, y_m, yaw_rad], WINDOW, highest_m=30.0).lowest_ray_mm
    rows, cols = np.nonzero(lowest_mm < NO_RAY)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    way = ends_m[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    centre_m = WINDOW.centre_of(np.column_stack([cols, rows])) - np.array([x_m, y_m])
    share = np.clip((centre_m @ way.T) / (way**2).sum(axis=1), 0, 1)  # (cells, rays)
    off_m = np.linalg.norm(centre_m[:, None] - share[..., None] * way, axis=2)
    # A sector of a scan with few rays, where it is widest.
    near = off_m < 0.1 + 0.125 * np.linalg.norm(centre_m, axis=1)[:, None]
    assert near.any(axis=1).all()
    passed_m = np.where(near, SENSOR_M + share * (ends_m[:, 2] - SENSOR_M), np.inf).min(axis=1)
    assert (lowest_mm[rows, cols] * 1e-3 >= passed_m - 0.35).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_invalid_ray_ends_cross_no_cells(scanned, placed, bad: float) -> None:
    for ends_m in ([[bad, 0, 0], [0, bad, 0], [bad, bad, 0], [0, 0, 0]], [[5, 0, np.nan]], np.empty((0, 3))):
        placed_scan = placed(scanned(ends_m, PointClass.GROUND), np.zeros(3), WINDOW)
        assert (placed_scan.lowest_ray_mm == NO_RAY).all()
        assert not hit(placed(scanned(ends_m), np.zeros(3), WINDOW).top_mm) - cells([[0, 0]])
