"""What stands on a site: boxes, walls and tree trunks, and rays cast against them and the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float, Int
from quadlog.open3d import import_open3d
from quadlog.simulation.robot.height_field import FLAT, HeightField

GROUND = 0
"""What a ray hit: the ground; obstacle i of the scene is i + 1, and NOTHING where it hit nothing."""
NOTHING = -1

_CYLINDER_SIDES = 64


@dataclass(frozen=True, slots=True)
class Box:
    """A box or wall: centre, full lengths along its own axes and turn about z, in map.

    It reaches from bottom_m, 0 for what stands, to height_m above the ground at its centre.
    """

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw_rad: float = 0.0
    bottom_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder, such as a tree trunk, in map, between bottom_m and height_m above the ground at its axis."""

    x_m: float
    y_m: float
    radius_m: float
    height_m: float
    bottom_m: float = 0.0


Obstacle = Box | Cylinder


class Hits(NamedTuple):
    """Where rays ended: range_m (N,), inf where nothing was hit, and what (N,): GROUND, obstacle + 1 or NOTHING."""

    range_m: Float
    what: Int


class RayCaster:
    """Casts rays against everything on the site that does not move (Open3D's RaycastingScene)."""

    def __init__(self, obstacles: tuple[Obstacle, ...], terrain: HeightField = FLAT) -> None:
        self._core = import_open3d().core
        self._scene = import_open3d().t.geometry.RaycastingScene()
        for vertices_m, triangles in (terrain.mesh(), *(_mesh(obstacle, terrain) for obstacle in obstacles)):
            self._scene.add_triangles(
                self._core.Tensor(vertices_m.astype(np.float32)), self._core.Tensor(triangles.astype(np.uint32))
            )

    def cast(self, origins_m: Float, directions: Float) -> Hits:
        """First hit of each ray: origins_m (N, 3) in map, directions (N, 3) of unit length."""
        rays = np.concatenate([origins_m, directions], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(self._core.Tensor(rays))
        what = answer["geometry_ids"].numpy().astype(np.int64)
        what[what == self._scene.INVALID_ID] = NOTHING
        return Hits(answer["t_hit"].numpy().astype(np.float64), what)

    def line_of_sight(self, from_m: Float, to_m: Float) -> np.ndarray:
        """(N,) bool: whether nothing stands between points from_m (N, 3) and to_m (N, 3)."""
        rays = np.concatenate([from_m, to_m - from_m], axis=1).astype(np.float32)
        blocked = self._scene.test_occlusions(self._core.Tensor(rays), tnear=0.0, tfar=1.0)
        return ~blocked.numpy()


def _mesh(obstacle: Obstacle, terrain: HeightField) -> tuple[Float, Int]:
    """Vertices (V, 3) in map and triangles (T, 3): the outline drawn up, a lid, and a lid below where it hangs."""
    if isinstance(obstacle, Box):
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [obstacle.length_m / 2, obstacle.width_m / 2]
        cos, sin = np.cos(obstacle.yaw_rad), np.sin(obstacle.yaw_rad)
        outline_m = corners @ np.array([[cos, sin], [-sin, cos]]) + [obstacle.x_m, obstacle.y_m]
    else:
        angle_rad = 2 * np.pi * np.arange(_CYLINDER_SIDES) / _CYLINDER_SIDES
        circle = np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
        outline_m = circle * obstacle.radius_m + [obstacle.x_m, obstacle.y_m]
    sides = len(outline_m)
    floor_m = float(terrain.height_at(np.array([[obstacle.x_m, obstacle.y_m]]))[0])
    hangs = obstacle.bottom_m > 0
    around_m = terrain.height_at(outline_m)
    # What stands reaches below the lowest ground along its outline, so that no light passes under it.
    low_m = floor_m + obstacle.bottom_m if hangs else float(around_m.min() - np.ptp(around_m))
    low = np.column_stack([outline_m, np.full(sides, low_m)])
    high = np.column_stack([outline_m, np.full(sides, floor_m + obstacle.height_m)])
    here = np.arange(sides)
    following = (here + 1) % sides
    walls = [
        np.column_stack([here, following, following + sides]),
        np.column_stack([here, following + sides, here + sides]),
    ]
    below = np.column_stack([np.zeros(sides - 2, dtype=np.int64), here[1:-1], here[2:]])
    lids = [below + sides, below] if hangs else [below + sides]
    return np.concatenate([low, high]), np.concatenate([*walls, *lids])
