"""What stands on a site: terrain, boxes, walls and tree trunks, and rays cast against them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from quadlog.messages import Float, Int
from quadlog.open3d import import_open3d

_EDGE_M = 200.0
"""A terrain reaches this far from map's origin: farther than any lidar sees."""
_WITHIN_95_PERCENT = 1.96
_STEPS_PER_CORRELATION = 5
_FADE_M = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Heights above z = 0 of map at the corners of a grid; each of its cells is two triangles.

    x_m: (X,) and y_m: (Y,), both increasing; height_m: (X, Y).
    """

    x_m: Float
    y_m: Float
    height_m: Float

    def height_at(self, xy_m: Float) -> Float:
        """(N,) height of the ground at points (N, 2) in map, on the triangles themselves; the edge's go on outside."""
        column, u = _cell(self.x_m, xy_m[:, 0])
        row, v = _cell(self.y_m, xy_m[:, 1])
        low, high = self.height_m[column, row], self.height_m[column + 1, row + 1]
        right, left = self.height_m[column + 1, row], self.height_m[column, row + 1]
        heights: Float = np.where(
            u >= v, low + u * (right - low) + v * (high - right), low + v * (left - low) + u * (high - left)
        )
        return heights

    def mesh(self) -> tuple[Float, Int]:
        """Vertices (X * Y, 3) in map and triangles (T, 3)."""
        x_m, y_m = np.meshgrid(self.x_m, self.y_m, indexing="ij")
        vertices_m = np.column_stack([x_m.ravel(), y_m.ravel(), self.height_m.ravel()])
        rows = len(self.y_m)
        low = (np.arange(len(self.x_m) - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
        right, left, high = low + rows, low + 1, low + rows + 1
        return vertices_m, np.concatenate([np.column_stack([low, right, high]), np.column_stack([low, high, left])])


def _cell(corner_m: Float, place_m: Float) -> tuple[Int, Float]:
    index = np.clip(np.searchsorted(corner_m, place_m, side="right") - 1, 0, len(corner_m) - 2)
    return index, (place_m - corner_m[index]) / (corner_m[index + 1] - corner_m[index])


def _along_x(x_m: list[float], height_m: list[float]) -> Terrain:
    return Terrain(np.array(x_m), np.array([-_EDGE_M, _EDGE_M]), np.repeat(np.array(height_m)[:, None], 2, axis=1))


FLAT = _along_x([-_EDGE_M, _EDGE_M], [0.0, 0.0])


def slope(angle_rad: float) -> Terrain:
    """A plane through the origin that rises towards +x."""
    rise_m = _EDGE_M * np.tan(angle_rad)
    return _along_x([-_EDGE_M, _EDGE_M], [-rise_m, rise_m])


def ramp(angle_rad: float, start_m: float, run_m: float) -> Terrain:
    """Flat, then up from x = start_m over run_m of x, then flat again."""
    top_m = run_m * np.tan(angle_rad)
    return _along_x([-_EDGE_M, start_m, start_m + run_m, _EDGE_M], [0.0, 0.0, top_m, top_m])


def undulating(
    rng: np.random.Generator, centre_m: tuple[float, float], half_width_m: float, band_m: float, correlation_m: float
) -> Terrain:
    """Gaussian-filtered noise in a square about centre_m; 95 % of the heights lie within +-band_m.

    correlation_m: where the autocorrelation exp(-(d / correlation_m)^2) has
    fallen to 1/e; the filter's standard deviation is half of it. Towards the
    square's edge the heights fade to the flat ground outside.
    """
    step_m = correlation_m / _STEPS_PER_CORRELATION
    steps = 2 * int(np.ceil(half_width_m / step_m))
    inside_m = (np.arange(steps + 1) - steps / 2) * step_m
    filter_steps = _STEPS_PER_CORRELATION / 2
    noise = gaussian_filter(rng.normal(size=(steps + 1, steps + 1)), filter_steps, mode="wrap")
    # White noise of variance 1 keeps 1 / (4 pi s^2) of it under a two-dimensional Gaussian filter.
    heights = noise * (2 * np.sqrt(np.pi) * filter_steps) * band_m / _WITHIN_95_PERCENT
    fade = np.clip((half_width_m - np.abs(inside_m)) / _FADE_M, 0.0, 1.0)
    x_m, y_m = (np.concatenate([[-_EDGE_M], at_m + inside_m, [_EDGE_M]]) for at_m in centre_m)
    return Terrain(x_m, y_m, np.pad(heights * fade[:, None] * fade, 1))


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

    def __init__(self, obstacles: tuple[Obstacle, ...], terrain: Terrain = FLAT) -> None:
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


def _mesh(obstacle: Obstacle, terrain: Terrain) -> tuple[Float, Int]:
    """Vertices (V, 3) in map and triangles (T, 3): the outline drawn up, a lid, and a lid below where it hangs."""
    outline_m = _box_outline(obstacle) if isinstance(obstacle, Box) else _cylinder_outline(obstacle)
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


def _box_outline(box: Box) -> Float:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [box.length_m / 2, box.width_m / 2]
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    return corners @ np.array([[cos, sin], [-sin, cos]]) + [box.x_m, box.y_m]


def _cylinder_outline(cylinder: Cylinder) -> Float:
    angle_rad = 2 * np.pi * np.arange(_CYLINDER_SIDES) / _CYLINDER_SIDES
    circle = np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
    return circle * cylinder.radius_m + [cylinder.x_m, cylinder.y_m]
