from __future__ import annotations

import numpy as np

from quadlog.simulation.sensors.lidar import BODY, part_centres, ray_ranges
from quadlog.simulation.sensors.scene import import_open3d
from quadlog.simulation.sensors.trajectory import PacingWalk

WALK = PacingWalk((2.0, 0.0), (6.0, 1.0), period_s=8.0)


def test_rays_meet_the_body_where_open3d_meets_its_cylinders():
    open3d = import_open3d()
    centres = part_centres(WALK, np.array([1.3]))[0]
    scene = open3d.t.geometry.RaycastingScene()
    for part, (x, y) in zip(BODY, centres, strict=True):
        mesh = open3d.geometry.TriangleMesh.create_cylinder(part.radius_m, part.high_m - part.low_m, resolution=256)
        mesh.translate([x, y, (part.high_m + part.low_m) / 2])
        scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(mesh))

    rng = np.random.default_rng(0)
    origins = np.column_stack([rng.uniform(-1, 1, (3000, 2)), rng.uniform(0.1, 2.5, 3000)])
    aims = np.column_stack([centres.mean(axis=0) + rng.normal(0, 0.3, (3000, 2)), rng.uniform(-0.2, 2.0, 3000)])
    directions = (aims - origins) / np.linalg.norm(aims - origins, axis=1, keepdims=True)
    ours = ray_ranges(origins, directions, np.broadcast_to(centres, (3000, *centres.shape)))
    theirs = scene.cast_rays(open3d.core.Tensor(np.hstack([origins, directions]).astype(np.float32)))["t_hit"].numpy()
    assert 500 < np.isfinite(theirs).sum() < 2900
    # Only rays that graze an edge may differ: theirs has corners.
    assert np.mean(np.isfinite(ours) != np.isfinite(theirs)) < 0.003
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert np.quantile(np.abs(ours[both] - theirs[both]), 0.995) < 2e-3


def test_the_trunk_goes_where_the_walk_goes_and_the_legs_swing_about_it():
    t_s = np.linspace(0, 8, 400)
    centres = part_centres(WALK, t_s)
    np.testing.assert_allclose(centres[:, 0], WALK.at(t_s).position_m)
    swing = centres[:, 2] + centres[:, 3] - 2 * centres[:, 0]
    np.testing.assert_allclose(swing, 0, atol=1e-12)
    assert 0.3 < np.linalg.norm(centres[:, 2] - centres[:, 3], axis=1).max() < 0.6


def test_a_ray_that_looks_away_meets_nobody():
    centres = part_centres(WALK, np.array([0.0]))
    origin = np.array([[0.0, 0.0, 1.0]])
    assert np.isfinite(ray_ranges(origin, np.array([[1.0, 0.0, 0.0]]), centres)).all()
    assert np.isinf(ray_ranges(origin, np.array([[-1.0, 0.0, 0.0]]), centres)).all()
    assert np.isinf(ray_ranges(origin, np.array([[0.0, 0.0, 1.0]]), centres)).all()
