"""How geometry spreads the error of ranges: dilution of precision over the ground, and 95 % ellipses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float

CHI2_95 = 5.991464547107979
"""A Gaussian error in the plane lies within d^T C^-1 d <= this in 95 of 100 cases; -2 ln 0.05."""
MARGIN_SHARE = 0.15
"""Of the shown extent, on every side, so that what happens just outside the anchors is seen."""
MAX_FACTOR = 2.0
"""A track that strays farther from the anchors than this, in their extent, does not stretch the map."""
MAP_PARTS = 20
"""A map is worked out in so many pieces: all at once it leaves the cache."""
ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5)
"""Widths of cells, times any power of ten."""


@dataclass(frozen=True, slots=True)
class DilutionMap:
    """Horizontal dilution of precision over a piece of map.

    hdop: (rows, columns) at the cells' centres, row = y, inf where ranges give no fix.
    origin_m: (2,) lower-left corner in map, a multiple of cell_m.
    """

    origin_m: Float
    cell_m: float
    tag_height_m: float
    hdop: Float


def dilution_at(position_m: Float, anchors_m: Float, tag_height_m: float) -> Float:
    """(N,) HDOP at positions (N, 2) from ranges to all anchors (A, 3): std of a fix (sqrt of the trace) per range std.

    With u the horizontal part of the unit vectors to the anchors, sqrt(trace((sum u u^T)^-1)), the Cramér-Rao
    bound of [Following]'s geometry; the tag's height is known. inf with fewer than three anchors, and where their
    directions are parallel: the limit is that of the Gauss-Newton fixes.
    """
    if len(anchors_m) < 3:
        return np.full(len(position_m), np.inf)
    x_m, y_m = (position_m[:, axis] - anchors_m[:, axis, None] for axis in range(2))
    level_m2 = x_m**2 + y_m**2
    square_m2 = np.maximum(level_m2 + (tag_height_m - anchors_m[:, 2, None]) ** 2, 1e-18)
    xx, xy, yy = ((each / square_m2).sum(axis=0) for each in (x_m**2, x_m * y_m, y_m**2))
    trace, determinant = xx + yy, xx * yy - xy * xy
    sharp = determinant > 1e-6 * trace**2
    hdop: Float = np.sqrt(np.where(sharp, trace, np.inf) / np.where(sharp, determinant, 1.0))
    return hdop


def map_dilution(anchors_m: Float, tag_height_m: float, track_m: Float, max_rows: int, max_columns: int) -> DilutionMap:
    """HDOP around anchors (A, 3) and along a track (T, 2), on at most max_rows by max_columns cells.

    Raises ValueError without an anchor.
    """
    low_m, high_m = _extent(anchors_m[:, :2], track_m)
    cell_m, first, last = _cells(low_m, high_m, max_rows, max_columns)
    x_m, y_m = ((np.arange(first[axis], last[axis]) + 0.5) * cell_m for axis in range(2))
    place_m = np.stack(np.meshgrid(x_m, y_m), axis=2)
    rows = [dilution_at(some.reshape(-1, 2), anchors_m, tag_height_m) for some in np.array_split(place_m, MAP_PARTS)]
    return DilutionMap(first * cell_m, cell_m, tag_height_m, np.concatenate(rows).reshape(len(y_m), len(x_m)))


def _extent(anchor_xy_m: Float, track_m: Float) -> tuple[Float, Float]:
    """Lower-left and upper-right corner (2,) of what is worth a look."""
    low_m, high_m = anchor_xy_m.min(axis=0), anchor_xy_m.max(axis=0)
    reach_m = MAX_FACTOR * max(float((high_m - low_m).max()), 1.0)
    track_m = track_m[np.isfinite(track_m).all(axis=1)].clip(low_m - reach_m, high_m + reach_m)
    points_m = np.concatenate([anchor_xy_m, track_m])
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    margin_m = MARGIN_SHARE * max(float((high_m - low_m).max()), 1.0)
    return low_m - margin_m, high_m + margin_m


def _cells(low_m: Float, high_m: Float, max_rows: int, max_columns: int) -> tuple[float, Float, Float]:
    """The smallest round width of cells that cover the extent, and the first (2,) and the end (2,) of their indices."""
    limit = np.array([max_columns, max_rows])
    exponent = int(np.floor(np.log10((high_m - low_m).max() / limit.max())))
    while True:
        for factor in ROUND:
            cell_m = factor * 10.0**exponent
            first, last = np.floor(low_m / cell_m), np.ceil(high_m / cell_m)
            if (last - first <= limit).all():
                return cell_m, first, last
        exponent += 1


def ellipse_95(covariance_m2: Float) -> tuple[Float, Float]:
    """Semi-axes (N,) of 95 % ellipses, the longer first.

    covariance_m2: (N, 2, 2); rows that are NaN give NaN.
    """
    xx, xy, yy = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    middle, off = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    major_m: Float = np.sqrt(CHI2_95 * (middle + off))
    minor_m: Float = np.sqrt(CHI2_95 * np.maximum(middle - off, 0.0))
    return major_m, minor_m


def radius_95(covariance_m2: Float, error_m: Float) -> Float:
    """(N,) how far the 95 % ellipses of (N, 2, 2) reach in the direction of errors (N, 2): inside means error below it.

    A zero error is given x's direction; NaN rows give NaN.
    """
    length_m = np.hypot(error_m[:, 0], error_m[:, 1])
    known = length_m > 0
    x, y = (np.where(known, error_m[:, axis] / np.where(known, length_m, 1.0), 1.0 - axis) for axis in range(2))
    xx, xy, yy = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    determinant = xx * yy - xy * xy
    radius_m: Float = np.sqrt(CHI2_95 * determinant / (yy * x * x - 2 * xy * x * y + xx * y * y))
    return np.where(np.isnan(length_m), np.nan, radius_m)
