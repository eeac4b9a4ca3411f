from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classified_scan import GroundPlane, PointClass
from quadlog.mapping.compact import GROUND, NO_TOP
from quadlog.mapping.grid import window_around

WINDOW = window_around(np.zeros(2), 0.1, 401)


def cells(xy_m: np.ndarray) -> set[tuple[int, int]]:
    return {(int(col), int(row)) for col, row in WINDOW.cell_of(xy_m)}


def hit(top_mm: np.ndarray) -> set[tuple[int, int]]:
    rows, cols = np.nonzero(top_mm > NO_TOP)
    return set(zip(cols.tolist(), rows.tolist(), strict=True))


def plane(normal: tuple[float, float, float], point: tuple[float, float, float]) -> GroundPlane:
    unit = np.array(normal) / np.linalg.norm(normal)
    return GroundPlane(unit, float(-unit @ np.array(point)))


@given(st.integers(0, 2**32), st.floats(-3, 3), st.floats(-1, 1), st.floats(-1.5, 1.5))
def test_points_lie_where_the_pose_of_their_time_puts_them(compacted, placed, seed, yaw_rad, speed, turn) -> None:
    """Thinning moves no point by more than its cell, and neither invents nor loses one."""
    random = np.random.default_rng(seed)
    xy_m, slot = random.uniform(-8, 8, (400, 2)), random.integers(0, 32, 400)
    xy_m = xy_m[np.abs(xy_m).max(axis=1) > 1.0]
    slot = slot[: len(xy_m)]
    t_s = (np.arange(32) + 0.5) * 0.1 / 32
    poses = np.column_stack([3 + speed * t_s, -2 * t_s, yaw_rad + turn * t_s])
    base_to_map = [transform_from_rpy(np.array([x, y, 0]), 0, 0, yaw) for x, y, yaw in poses]
    places = [apply_transform(base_to_map[s], np.array([[*at, 0]])) for s, at in zip(slot, xy_m, strict=True)]
    true_m = np.concatenate(places)[:, :2]
    compact = compacted(np.column_stack([xy_m, np.ones(len(xy_m))]), slot=slot)
    found = hit(placed(compact, poses, WINDOW).top_mm)
    # A millimetre of rounding may put a point that lies on an edge into the next cell.
    corners = [(0, 0), (2e-3, 2e-3), (2e-3, -2e-3), (-2e-3, 2e-3), (-2e-3, -2e-3)]
    assert found <= set().union(*(cells(true_m + np.array(each)) for each in corners))
    by_thinning = {(col + a, row + b) for col, row in found for a in (-1, 0, 1) for b in (-1, 0, 1)}
    assert cells(true_m) <= by_thinning


def test_heights_of_a_cell_are_those_of_the_highest_point(compacted, placed) -> None:
    points = [[2.05, 0.05, 0.3], [2.06, 0.01, 1.2], [2.02, 0.03, 0.7], [2.15, 0.05, 0.4]]
    top_mm = placed(compacted(points), np.zeros(3), WINDOW).top_mm
    assert top_mm[top_mm > NO_TOP].tolist() == [1200, 400]


@pytest.mark.parametrize(
    ("min_points", "has_ground", "n_hit"), [(1, True, 2), (3, True, 1), (4, True, 0), (1, False, 2), (4, False, 2)]
)
def test_a_cell_needs_its_points_also_those_that_were_thinned(compacted, placed, min_points, has_ground, n_hit) -> None:
    """But not in a scan without ground: of a wall, a 2-D scanner sees a point a cell."""
    points = [[2.051, 0.051, 0.3], [2.052, 0.051, 0.3], [2.053, 0.051, 0.3], [2.15, 0.05, 0.4]]
    scan = compacted(points, counts=True)
    if has_ground:
        scan = replace(scan, ground=np.zeros(1, GROUND))
    assert len(hit(placed(scan, np.zeros(3), WINDOW, min_points=min_points).top_mm)) == n_hit


def test_low_high_and_sunken_points_do_not_block(compacted) -> None:
    points = [[3 + z, 0, z] for z in (-0.2, 0.0, 0.04, 0.06, 1.49, 1.51, 5.0)]
    assert len(compacted(points, ground=plane((0, 0, 1), (0, 0, 0))).obstacle) == 2
    assert len(compacted([[3, 0, 0.0], [3, 0, 1.0]]).obstacle) == 1, "without ground heights are those of base"


def test_a_wall_taken_for_the_ground_hides_no_obstacle(compacted) -> None:
    compact = compacted([[2.0, 0.0, 0.5], [4.0, 1.0, 1.0], [5.5, -1.0, 0.3]], ground=plane((-1, 0, 0.05), (6, 0, 0)))
    assert len(compact.obstacle) == 3


def test_the_robots_own_body_neither_blocks_nor_ends_rays(compacted) -> None:
    inside = [[0.40, 0.0, 0.3], [-0.40, 0.22, 0.3], [0.0, -0.22, 0.1]]
    outside = [[0.42, 0.0, 0.3], [0.0, 0.24, 0.3]]
    assert len(compacted(inside + outside).obstacle) == len(compacted(outside).obstacle) == 2
    assert len(compacted(inside).rays.ray) == 0


def test_the_targets_own_returns_do_not_block(compacted, placed) -> None:
    compact = compacted([[3.0, 0.0, 1.0], [3.0, 0.45, 1.0], [3.0, 0.55, 1.0]])
    top_mm = placed(compact, np.array([1.0, 1.0, np.pi / 2]), WINDOW, np.array([1.0, 4.0])).top_mm
    assert hit(top_mm) == cells(np.array([[0.45, 4.0]]))


def test_ground_is_averaged_by_cell(compacted) -> None:
    random = np.random.default_rng(0)
    xyz_m = np.column_stack([random.uniform(1.02, 1.18, (500, 2)), random.normal(0.1, 0.01, 500)])
    compact = compacted(xyz_m, PointClass.GROUND)
    x, y, z_mm, count, _ = compact.ground[0].tolist()
    assert (len(compact.ground), count) == (1, 500)
    assert [x * compact.unit_m, y * compact.unit_m, z_mm / 1e3] == pytest.approx(xyz_m.mean(axis=0), abs=2e-3)


@given(st.integers(0, 300), st.integers(0, 2**32), st.sampled_from([5.0, 15.0, 300.0, 3000.0]))
def test_compact_scans_are_no_larger_than_scans_and_end_at_their_reach(compacted, n, seed, reach_m) -> None:
    random = np.random.default_rng(seed)
    xyz_m = random.normal(0, reach_m, (n, 3)).clip(-1e4, 1e4)
    compact = compacted(xyz_m, random.integers(0, 5, n), reach_m=reach_m, height_m=random.uniform(-1, 3, n))
    assert max(len(compact.obstacle), len(compact.ground), len(compact.rays.ray)) <= n
    away_m = np.hypot(compact.obstacle["x"] * compact.unit_m, compact.obstacle["y"] * compact.unit_m)
    assert away_m.max(initial=0) <= reach_m * 1.001 + 2 * compact.unit_m
