from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import GroundPlane, PointClass
from quadlog.mapping.grid import window_around
from quadlog.mapping.placing import NO_RAY, NO_TOP

WINDOW = window_around(np.zeros(2), 0.1, 401)


def cells(xy_m) -> set[tuple[int, int]]:
    return {(int(col), int(row)) for col, row in WINDOW.cell_of(np.asarray(xy_m))}


def hit(top_mm: np.ndarray) -> set[tuple[int, int]]:
    rows, cols = np.nonzero(top_mm > NO_TOP)
    return set(zip(cols.tolist(), rows.tolist(), strict=True))


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
    blocks = (z_m >= 0.05) & (z_m <= 1.5)
    top_mm = placed(scanned(np.column_stack([xy_m, z_m]), slot=slot), poses, WINDOW).top_mm
    # float32 may put a point that lies on an edge into the next cell.
    clear = np.abs((true_m / 0.1) % 1 - 0.5).max(axis=1) < 0.4999
    assert hit(top_mm) >= cells(true_m[blocks & clear])
    assert hit(top_mm) - cells(true_m[blocks & clear]) <= cells(true_m[blocks & ~clear] + [1e-5, 1e-5]) | cells(
        true_m[blocks & ~clear] - [1e-5, 1e-5]
    )
    highest = {}
    for cell, height_m in zip(map(tuple, WINDOW.cell_of(true_m[blocks]).tolist()), z_m[blocks], strict=True):
        highest[cell] = max(highest.get(cell, 0), height_m)
    if clear.all():
        assert all(abs(top_mm[row, col] - 1e3 * height_m) <= 1 for (col, row), height_m in highest.items())


@pytest.mark.parametrize(
    ("min_points", "has_ground", "n_hit"), [(1, True, 2), (3, True, 1), (4, True, 0), (1, False, 2), (4, False, 2)]
)
def test_a_cell_needs_its_points(scanned, placed, min_points, has_ground, n_hit) -> None:
    """But not in a scan without ground: of a wall, a 2-D scanner sees a point a cell."""
    points = [[2.051, 0.051, 0.3], [2.052, 0.051, 0.3], [2.053, 0.051, 0.3], [2.15, 0.05, 0.4], [3.0, 3.0, 0.0]]
    label = np.full(5, PointClass.OBSTACLE, np.uint8)
    label[-1] = PointClass.GROUND if has_ground else PointClass.OUTLIER
    assert len(hit(placed(scanned(points, label), np.zeros(3), WINDOW, min_points=min_points).top_mm)) == n_hit


def plane(normal: tuple[float, float, float], point: tuple[float, float, float]) -> GroundPlane:
    unit = np.array(normal) / np.linalg.norm(normal)
    return GroundPlane(unit, float(-unit @ np.array(point)))


def test_a_wall_taken_for_the_ground_hides_no_obstacle(scanned, placed) -> None:
    scan = scanned([[2.0, 0.0, 0.5], [4.0, 1.0, 1.0], [5.5, -1.0, 0.3]], ground=plane((-1, 0, 0.05), (6, 0, 0)))
    assert len(hit(placed(scan, np.zeros(3), WINDOW).top_mm)) == 3


def test_neither_the_robots_own_body_nor_the_target_blocks(scanned, placed) -> None:
    inside = [[0.40, 0.0, 0.3], [-0.40, 0.22, 0.3], [0.0, -0.22, 0.1]]
    outside = [[0.42, 0.0, 0.3], [0.0, 0.24, 0.3]]
    assert hit(placed(scanned(inside + outside), np.zeros(3), WINDOW).top_mm) == cells(np.array(outside)[:, :2])
    assert (placed(scanned(inside), np.zeros(3), WINDOW).lowest_ray_mm == NO_RAY).all(), "nor ends rays"
    target = scanned([[3.0, 0.0, 1.0], [3.0, 0.45, 1.0], [3.0, 0.55, 1.0]])
    top_mm = placed(target, np.array([1.0, 1.0, np.pi / 2]), WINDOW, (1.0, 4.0)).top_mm
    assert hit(top_mm) == cells([[0.45, 4.0]])
