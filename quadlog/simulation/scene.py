"""What stands on a site: boxes, walls and tree trunks on flat ground, and rays cast against them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float, Int
from quadlog.open3d_import import import_open3d

GROUND = 0
"""What a ray hit: the ground; obstacle i of the scene is i + 1, and NOTHING where it hit nothing."""
NOTHING = -1

_GROUND_EDGE_M = 400.0
_CYLINDER_SIDES = 64


@dataclass(frozen=True, slots=True)
class Box:
    """A box or wall standing on z = 0: centre, full lengths along its own axes and turn about z, in map."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder standing on z = 0, such as a tree trunk, in map."""

    x_m: float
    y_m: float
    radius_m: float
    height_m: float


Obstacle = Box | Cylinder


class Hits(NamedTuple):
    """Where rays ended: range_m (N,), inf where nothing was hit, and what (N,): GROUND, obstacle + 1 or NOTHING."""

    range_m: Float
    what: Int


class RayCaster:
    """Casts rays against everything on the site that does not move (Open3D's RaycastingScene)."""

    def __init__(self, obstacles: tuple[Obstacle, ...]) -> None:
        self._core = import_open3d().core
        self._scene = import_open3d().t.geometry.RaycastingScene()
        for vertices_m, triangles in (_ground_mesh(), *(_mesh(obstacle) for obstacle in obstacles)):
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


def _ground_mesh() -> tuple[Float, Int]:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * _GROUND_EDGE_M / 2
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _mesh(obstacle: Obstacle) -> tuple[Float, Int]:
    """Vertices (V, 3) in map and triangles (T, 3): the outline drawn up from the ground, and a lid."""
    outline_m = _box_outline(obstacle) if isinstance(obstacle, Box) else _cylinder_outline(obstacle)
    sides = len(outline_m)
    low = np.column_stack([outline_m, np.zeros(sides)])
    high = np.column_stack([outline_m, np.full(sides, obstacle.height_m)])
    here = np.arange(sides)
    following = (here + 1) % sides
    walls = [
        np.column_stack([here, following, following + sides]),
        np.column_stack([here, following + sides, here + sides]),
    ]
    lid = np.column_stack([np.full(sides - 2, sides), here[1:-1] + sides, here[2:] + sides])
    return np.concatenate([low, high]), np.concatenate([*walls, lid])


def _box_outline(box: Box) -> Float:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [box.length_m / 2, box.width_m / 2]
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    return corners @ np.array([[cos, sin], [-sin, cos]]) + [box.x_m, box.y_m]


def _cylinder_outline(cylinder: Cylinder) -> Float:
    angle_rad = 2 * np.pi * np.arange(_CYLINDER_SIDES) / _CYLINDER_SIDES
    circle = np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
    return circle * cylinder.radius_m + [cylinder.x_m, cylinder.y_m]
