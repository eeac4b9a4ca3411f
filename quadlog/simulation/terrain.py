"""The ground as triangles over a rectilinear grid: flat, sloping, a ramp, or gently undulating."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from quadlog.messages import Float, Int

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
