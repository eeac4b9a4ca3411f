"""95 % ellipses of positions in the plane."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float

CHI2_95 = 5.991464547107979
"""A Gaussian error in the plane lies within d^T C^-1 d <= this in 95 of 100 cases; -2 ln 0.05."""


def ellipse_95(covariance_m2: Float) -> tuple[Float, Float]:
    """Semi-axes (N,) of the 95 % ellipses of (N, 2, 2), the longer first; NaN rows give NaN."""
    xx, xy, yy = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    middle, off = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    return np.sqrt(CHI2_95 * (middle + off)), np.sqrt(CHI2_95 * np.maximum(middle - off, 0.0))


def radius_95(covariance_m2: Float, error_m: Float) -> Float:
    """(N,) how far the 95 % ellipses of (N, 2, 2) reach towards errors (N, 2), zero ones along x; NaN rows give NaN."""
    length_m = np.hypot(error_m[:, 0], error_m[:, 1])
    known = length_m > 0
    x, y = (np.where(known, error_m[:, axis] / np.where(known, length_m, 1.0), 1.0 - axis) for axis in range(2))
    xx, xy, yy = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    determinant = xx * yy - xy * xy
    radius_m: Float = np.sqrt(CHI2_95 * determinant / (yy * x * x - 2 * xy * x * y + xx * y * y))
    return np.where(np.isnan(length_m), np.nan, radius_m)
