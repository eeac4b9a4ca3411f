from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.robot.height_field import FLAT, Extent, slope, undulating
from quadlog.simulation.sensors.scene import GROUND, Box, Cylinder, RayCaster

OBSTACLES = (Box(3.0, 0.5, 1.0, 2.0, 1.5, yaw_rad=0.4), Cylinder(-2.0, 1.0, 0.5, 3.0), Box(0.0, -4.0, 6.0, 0.2, 2.0))


@pytest.fixture(scope="module")
def caster() -> RayCaster:
    return RayCaster(OBSTACLES)


def random_rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    return np.tile([0.0, 0.0, 0.5], (count, 1)), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_hits_lie_on_the_surface_that_is_named(caster, distance_to):
    origins, directions = random_rays(4000)
    hits = caster.cast(origins, directions)
    ends = origins + directions * hits.range_m[:, None]
    assert np.abs(ends[hits.what == GROUND, 2]).max() < 1e-4
    for index, obstacle in enumerate(OBSTACLES):
        mine = ends[hits.what == index + 1]
        assert len(mine) > 20
        # A cylinder is drawn with 64 sides: at most 0.6 mm inside the round one.
        assert np.abs(distance_to(obstacle)(mine)).max() < 1e-3


def test_a_ray_ends_at_the_first_surface(caster, distance_to):
    origins, directions = random_rays(1500)
    hits = caster.cast(origins, directions)
    reach = np.where(np.isfinite(hits.range_m), hits.range_m, 15.0)
    for share in np.linspace(0.0, 0.995, 200):
        on_the_way = origins + directions * (reach * share)[:, None]
        assert on_the_way[:, 2].min() > -1e-6
        for obstacle in OBSTACLES:
            assert distance_to(obstacle)(on_the_way).min() > -2e-3


def test_sight_is_lost_exactly_where_the_segment_enters_something(caster, distance_to):
    rng = np.random.default_rng(1)
    start = np.column_stack([rng.uniform(-6, 6, (300, 2)), rng.uniform(0.3, 2.5, 300)])
    end = np.column_stack([rng.uniform(-6, 6, (300, 2)), rng.uniform(0.3, 2.5, 300)])
    along = np.linspace(0, 1, 501)[:, None, None]
    samples = (start + along * (end - start)).reshape(-1, 3)
    depth = np.min([distance_to(obstacle)(samples) for obstacle in OBSTACLES], axis=0).reshape(501, 300)
    outside_ends = (depth[0] > 0) & (depth[-1] > 0)
    grazing = np.abs(depth.min(axis=0)) < 0.01
    judged = outside_ends & ~grazing
    blocked = depth.min(axis=0) < 0
    assert (judged & blocked).sum() > 25
    assert (judged & ~blocked).sum() > 25
    np.testing.assert_array_equal(caster.line_of_sight(start, end)[judged], ~blocked[judged])


def test_on_a_slope_obstacles_stand_on_the_ground_at_their_middle_with_no_gap_below():
    terrain = slope(np.deg2rad(20.0))
    obstacles = (Box(5.0, 0.0, 2.0, 1.0, 0.6, yaw_rad=0.3), Cylinder(-4.0, 2.0, 0.3, 2.0))
    caster = RayCaster(obstacles, terrain)
    for index, obstacle in enumerate(obstacles):
        above = np.array([[obstacle.x_m, obstacle.y_m, 10.0]])
        hit = caster.cast(above, np.array([[0.0, 0.0, -1.0]]))
        assert hit.what.tolist() == [index + 1]
        top = np.tan(np.deg2rad(20.0)) * obstacle.x_m + obstacle.height_m
        np.testing.assert_allclose(10.0 - hit.range_m, top, atol=1e-5)
        # Along the ground from every side the obstacle is met, never passed below.
        around = np.linspace(0, 2 * np.pi, 36)
        centre = np.array([obstacle.x_m, obstacle.y_m])
        foot = centre + 3.0 * np.column_stack([np.cos(around), np.sin(around)])
        ends = [np.column_stack([xy, terrain.height_at(xy) + 0.01]) for xy in (foot, np.tile(centre, (36, 1)))]
        assert not caster.line_of_sight(*ends).any()


WAVY = undulating(0.12, 1.0, extent=Extent(-12.0, -17.0, 18.0, 13.0), cell_m=0.2, fade_m=3.0)


@pytest.mark.parametrize("terrain", [FLAT, slope(0.3), WAVY], ids=["flat", "slope", "wavy"])
def test_vertical_rays_end_at_the_terrains_height(terrain):
    rng = np.random.default_rng(1)
    xy = np.concatenate([rng.uniform(-20, 20, (3000, 2)), rng.uniform(-150, 150, (300, 2))])
    above = np.column_stack([xy, np.full(len(xy), 60.0)])
    hits = RayCaster((), terrain).cast(above, np.tile([0.0, 0.0, -1.0], (len(xy), 1)))
    assert (hits.what == GROUND).all()
    np.testing.assert_allclose(60.0 - hits.range_m, terrain.height_at(xy), atol=5e-5)
