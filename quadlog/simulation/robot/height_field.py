"""The ground that robots walk on, rays end at and obstacles stand on: heights at the corners of a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, median_filter

from quadlog.errors import TooLarge
from quadlog.messages import Float, Float32, Int

MOST_CORNERS = 1 << 22
FRICTION = 0.8
EDGE_M = 200.0
"""A ground reaches this far from map's origin: farther than any lidar sees."""
_BAND = (2.5, 97.5)
_RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])


class Extent(NamedTuple):
    """A rectangle in map, in metres."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float


COURSES = Extent(-8.0, -4.0, 14.0, 14.0)
"""Holds the line from (0, 0) to (10, 10) and the circle of 5 m to the left of (0, 0), and some way beyond."""


@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights above z = 0 of map at the corners of a grid, at least two each way; the edge's go on outside.

    A cell is two triangles that meet along its diagonal from the lower left, as MuJoCo has it.
    height_m: (rows, cols) float32; corner (row, col) lies at origin_m + cell_m * (col, row).
    A ground of 2 x 2 corners is a plane, and is simulated as one without end.
    """

    height_m: Float32
    cell_m: float
    origin_m: tuple[float, float]

    def __post_init__(self) -> None:
        if self.height_m.size > MOST_CORNERS:
            raise TooLarge("the ground's corners", self.height_m.size, MOST_CORNERS)
        if min(self.height_m.shape) < 2 or not np.isfinite(self.height_m).all() or not self.cell_m > 0:
            raise ValueError("a ground needs 2 x 2 finite heights and a cell above 0 m")
        if self.is_plane and abs(np.diff(np.diff(self.height_m.astype(np.float64), axis=0))).max() > 1e-4 * self.cell_m:
            raise ValueError("a ground of 2 x 2 heights must be a plane")

    @property
    def is_plane(self) -> bool:
        """Whether it goes on without end."""
        return self.height_m.shape == (2, 2)

    def over(self, extent: Extent) -> HeightField:
        """The same over an extent alone, a cell more at most: cut where it reaches farther, else its edge goes on."""
        picked, first = [], []
        spans = zip(self.origin_m, extent[:2], extent[2:], self.height_m.shape[::-1], strict=True)
        for origin_m, low_m, high_m, count in spans:
            low, high = math.floor((low_m - origin_m) / self.cell_m), math.ceil((high_m - origin_m) / self.cell_m)
            # Three corners each way at least, so that it is not taken for an endless plane.
            picked.append(np.clip(np.arange(low, max(high, low + 2) + 1), 0, count - 1))
            first.append(origin_m + low * self.cell_m)
        return HeightField(self.height_m[np.ix_(picked[1], picked[0])], self.cell_m, (first[0], first[1]))

    def height_at(self, xy_m: Float) -> Float:
        """(N,) heights at points (N, 2) in map."""
        rows, cols = self.height_m.shape
        x_m, y_m = np.asarray(xy_m, np.float64).T
        u = np.clip((x_m - self.origin_m[0]) / self.cell_m, 0.0, cols - 1.0)
        v = np.clip((y_m - self.origin_m[1]) / self.cell_m, 0.0, rows - 1.0)
        col, row = np.minimum(u.astype(np.int64), cols - 2), np.minimum(v.astype(np.int64), rows - 2)
        u, v = u - col, v - row
        low, high = self.height_m[row, col], self.height_m[row + 1, col + 1]
        right, left = self.height_m[row, col + 1], self.height_m[row + 1, col]
        heights: Float = np.where(
            u >= v, low + u * (right - low) + v * (high - right), low + v * (left - low) + u * (high - left)
        )
        return heights

    def mesh(self) -> tuple[Float, Int]:
        """Vertices (V, 3) in map and triangles (T, 3), to EDGE_M each way."""
        x_m, y_m = (
            origin_m + self.cell_m * np.arange(count)
            for origin_m, count in zip(self.origin_m, self.height_m.shape[::-1], strict=True)
        )
        height_m = self.height_m.astype(np.float64)
        if not self.is_plane:
            x_m, y_m = (np.concatenate([[-EDGE_M], along_m, [EDGE_M]]) for along_m in (x_m, y_m))
            height_m = np.pad(height_m, 1, mode="edge")
        x_m, y_m = np.meshgrid(x_m, y_m, indexing="ij")
        cols, rows = x_m.shape
        low = (np.arange(cols - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
        right, left, high = low + rows, low + 1, low + rows + 1
        triangles = np.concatenate([np.column_stack([low, right, high]), np.column_stack([low, high, left])])
        return np.column_stack([x_m.ravel(), y_m.ravel(), height_m.T.ravel()]), triangles

    def too_steep_for(self, friction: float = FRICTION) -> str | None:
        """Why a foot cannot hold somewhere: the steepest rise exceeds the friction cone; None when it can."""
        along_x = np.diff(self.height_m.astype(np.float64), axis=1) / self.cell_m
        along_y = np.diff(self.height_m.astype(np.float64), axis=0) / self.cell_m
        # Of a cell's two triangles, below its diagonal and above it.
        steepest = np.maximum(np.hypot(along_x[:-1], along_y[:, 1:]), np.hypot(along_x[1:], along_y[:, :-1]))
        worst = int(steepest.argmax())
        row, col = divmod(worst, steepest.shape[1])
        rise = float(steepest.flat[worst])
        if rise <= friction:
            return None
        x_m, y_m = (self.origin_m[k] + (cell + 0.5) * self.cell_m for k, cell in enumerate((col, row)))
        return (
            f"the ground rises by {math.degrees(math.atan(rise)):.0f} degrees at ({x_m:.1f}, {y_m:.1f}) m, "
            f"but with a friction of {friction:g} feet hold up to {math.degrees(math.atan(friction)):.0f} degrees"
        )


def slope(angle_rad: float, heading_rad: float = 0.0) -> HeightField:
    """A plane through the origin that rises by an angle in the direction of heading_rad; level with angle 0."""
    corner_m = np.array([-EDGE_M, EDGE_M])
    ahead_m = corner_m * math.cos(heading_rad) + corner_m[:, None] * math.sin(heading_rad)
    return HeightField((math.tan(angle_rad) * ahead_m).astype(np.float32), 2 * EDGE_M, (-EDGE_M, -EDGE_M))


def flat() -> HeightField:
    """Level, at z = 0."""
    return slope(0.0)


FLAT = flat()


def undulating(
    band_m: float,
    correlation_m: float = 0.25,
    seed: int | np.random.Generator = 0,
    extent: Extent = COURSES,
    cell_m: float = 0.05,
    fade_m: float = 0.0,
) -> HeightField:
    """Gaussian-filtered noise about z = 0; "3 cm" is band_m = 0.03.

    band_m: peak to peak of the middle 95 % of the heights, from the 2.5th to the 97.5th percentile.
    correlation_m: where the autocorrelation exp(-(d / correlation_m)^2) has fallen to 1/e; the filter's standard
    deviation is half of it. fade_m: how far from the edge the heights begin to fade to 0.
    """
    columns = math.ceil((extent.x1_m - extent.x0_m) / cell_m) + 1
    rows = math.ceil((extent.y1_m - extent.y0_m) / cell_m) + 1
    if columns * rows > MOST_CORNERS:
        raise TooLarge("the ground's corners", columns * rows, MOST_CORNERS)
    noise = np.random.default_rng(seed).standard_normal((rows, columns))
    smooth = gaussian_filter(noise, correlation_m / 2 / cell_m, mode="wrap")
    low, middle, high = np.percentile(smooth, [_BAND[0], 50.0, _BAND[1]])
    heights = (smooth - middle) * (band_m / (high - low))
    if fade_m > 0:
        across, along = (np.minimum(np.arange(count), np.arange(count)[::-1]) * cell_m for count in heights.shape)
        heights *= np.clip(across / fade_m, 0.0, 1.0)[:, None] * np.clip(along / fade_m, 0.0, 1.0)
    return HeightField(heights.astype(np.float32), cell_m, (extent.x0_m, extent.y0_m))


def s_course(band_m: float = 0.045, seed: int = 0) -> HeightField:
    """[Tracking]'s outdoor course: 15 degrees up on its first straight, 20 degrees down on its last, undulating.

    The straights lie along x, from 0 to 6 m and from 18 to 24 m. The paper does not say where on them the slopes
    begin: here their first and their last metre are level.
    """
    extent = Extent(-3.0, -4.0, 28.0, 10.0)
    uneven = undulating(band_m, seed=seed, extent=extent)
    top_m = 4.0 * math.tan(math.radians(15.0))
    end_m = top_m - 4.0 * math.tan(math.radians(20.0))
    x_m = extent.x0_m + uneven.cell_m * np.arange(uneven.height_m.shape[1])
    profile = np.interp(x_m, [1.0, 5.0, 19.0, 23.0], [0.0, top_m, top_m, end_m])
    return HeightField((uneven.height_m + profile).astype(np.float32), uneven.cell_m, uneven.origin_m)


def from_height_map(height_m: Float, cell_m: float, origin_m: Float) -> HeightField:
    """The ground that a run saw: heights (rows, cols) of cells, NaN where unknown, and the lower-left corner (2,).

    A cell's height is taken for its centre; an unknown cell is as high as the nearest known one, and one that feet
    would slip off as its neighbours' median: a single cell is no step. Raises TooLarge, and ValueError when no cell is
    known.
    """
    if height_m.size > MOST_CORNERS:
        raise TooLarge("the ground's cells", height_m.size, MOST_CORNERS)
    known = np.isfinite(height_m)
    if not known.any():
        raise ValueError("no height is known")
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = np.asarray(height_m, np.float64)[tuple(nearest)]
    around = median_filter(filled, footprint=_RING, mode="nearest")
    filled = np.where(np.abs(filled - around) > FRICTION * cell_m, around, filled)
    # Three cells each way at least, so that it is not taken for an endless plane.
    missing = [(0, max(3 - length, 0)) for length in filled.shape]
    filled = np.pad(filled, missing, mode="edge")
    first_m = np.asarray(origin_m, np.float64) + cell_m / 2
    return HeightField(filled.astype(np.float32), float(cell_m), (float(first_m[0]), float(first_m[1])))
