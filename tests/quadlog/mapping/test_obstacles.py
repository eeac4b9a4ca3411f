from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar.classify import ClassifiedScan
from quadlog.lidar.ground import Ground, height_above_ground
from quadlog.lidar.points import PointClass
from quadlog.mapping.obstacles import ObstacleSettings, obstacle_points, ray_ends

SETTINGS = ObstacleSettings(min_height_m=0.05, max_height_m=1.5, target_radius_m=0.5, body_margin_m=0.1)


def scan_of(points: list, ground: Ground | None = None, label: PointClass = PointClass.OBSTACLE) -> ClassifiedScan:
    xyz_m = np.array(points, dtype=np.float64)
    labels = np.full(len(points), label, dtype=np.uint8)
    return ClassifiedScan(xyz_m, labels, ground, height_above_ground(xyz_m, ground), "paper")


def plane(normal: tuple[float, float, float], point: tuple[float, float, float]) -> Ground:
    unit = np.array(normal) / np.linalg.norm(normal)
    return Ground(unit, float(-unit @ np.array(point)), np.zeros(0, dtype=np.bool_))


def test_points_are_placed_in_map_by_the_pose() -> None:
    points = [[2.0, 1.0, 0.5], [3.0, -1.0, 0.5]]
    pose = np.array([10.0, -4.0, 0.7])
    base_to_map = transform_from_rpy(np.array([10.0, -4.0, 0.0]), 0.0, 0.0, 0.7)
    expected = apply_transform(base_to_map, np.array(points))[:, :2]
    found = obstacle_points(scan_of(points), pose, None, SETTINGS)
    assert found == pytest.approx(np.column_stack([expected, [0.5, 0.5]]))


def test_low_high_and_sunken_points_do_not_block() -> None:
    points = [[3, 0, z] for z in (-0.2, 0.0, 0.04, 0.06, 1.49, 1.51, 5.0)]
    blocking = obstacle_points(scan_of(points, plane((0, 0, 1), (0, 0, 0))), np.zeros(3), None, SETTINGS)
    assert len(blocking) == 2


def test_without_ground_heights_are_those_of_base() -> None:
    assert len(obstacle_points(scan_of([[3, 0, 0.0], [3, 0, 1.0]]), np.zeros(3), None, SETTINGS)) == 1


def test_a_wall_taken_for_the_ground_hides_no_obstacle() -> None:
    wall = plane((-1.0, 0.0, 0.05), (6.0, 0.0, 0.0))
    points = [[2.0, 0.0, 0.5], [4.0, 1.0, 1.0], [5.5, -1.0, 0.3]]
    assert len(obstacle_points(scan_of(points, wall), np.zeros(3), None, SETTINGS)) == 3


@pytest.mark.parametrize("other", [PointClass.INVALID, PointClass.CROPPED, PointClass.OUTLIER, PointClass.GROUND])
def test_other_classes_do_not_block(other: PointClass) -> None:
    assert len(obstacle_points(scan_of([[3, 0, 1.0]], label=other), np.zeros(3), None, SETTINGS)) == 0


def test_the_robots_own_body_does_not_block_however_it_is_turned() -> None:
    inside = [[0.40, 0.0, 0.3], [-0.40, 0.22, 0.3], [0.0, -0.22, 0.1]]
    outside = [[0.42, 0.0, 0.3], [0.0, 0.24, 0.3]]
    found = obstacle_points(scan_of(inside + outside), np.array([1.0, 2.0, 2.5]), None, SETTINGS)
    assert len(found) == 2


def test_the_targets_own_returns_do_not_block() -> None:
    pose = np.array([1.0, 1.0, np.pi / 2])
    scan = scan_of([[3.0, 0.0, 1.0], [3.0, 0.45, 1.0], [3.0, 0.55, 1.0]])
    found = obstacle_points(scan, pose, np.array([1.0, 4.0]), SETTINGS)
    assert found == pytest.approx(np.array([[0.45, 4.0, 1.0]]))


def test_rays_end_at_surfaces_and_not_on_the_robot() -> None:
    scan = scan_of([[3, 0, 0.5], [4, 0, 1.0], [0.2, 0.1, 0.3], [5, 0, 0.2], [6, 0, 2.5]])
    scan.label[:] = [
        PointClass.OBSTACLE,
        PointClass.GROUND,
        PointClass.OBSTACLE,
        PointClass.OUTLIER,
        PointClass.OBSTACLE,
    ]
    end_m, height_m = ray_ends(scan, SETTINGS)
    assert end_m is scan.xyz_base_m
    assert height_m == pytest.approx([0.5, 1.0, np.nan, np.nan, 2.5], nan_ok=True)
