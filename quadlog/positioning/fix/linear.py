"""Linear fixes: squared ranges are linear in the position once the unknown |p|^2 is out of the way.

    d_i^2 - s^2 - |a_i|^2 = |p|^2 - 2 a_i . p,  with noise of variance v_i = 4 s^2 d_i^2 + 2 s^4

s is the std of a range, and s^2 what noise adds to a squared range on average. Differences of rows remove |p|^2.
Subtracting one reference station's row from all others makes them correlated; with C^-1 of these rows as weights the
fix depends on no choice of reference, and equals the fit that keeps |p|^2 as an unknown and weighs row i by 1/v_i:
Sherman-Morrison, written down without a matrix of A x A.

Every solver takes anchors (A, 3), ranges (E, A), NaN where absent, the tag's height or None to solve for it, and the
std of the ranges. Its covariance is that of its own weights, not of the best there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.positioning.fix.least_squares import SPREAD_OF_RANGE_STD, Fixes, complete_fixes, invert_normal


def solve_linear(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float, outlier_m: float
) -> Fixes:
    """Least squares with every row alike, less their mean: no station is special."""
    fit = _fit(anchors_m, range_m, tag_height_m, range_std_m, np.ones_like(range_m), against_last=False)
    return _complete(anchors_m, range_m, fit, outlier_m)


def solve_weighted(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float, outlier_m: float
) -> Fixes:
    """Weighted least squares with the full covariance C of the rows [Following, right form].

    Against reference station n, C = 4 s^2 [diag(d_i^2) + d_n^2 11^T] + 2 s^4 [I + 11^T] and W = C^-1; here in the form
    that needs no reference.
    """
    variance_m2 = np.square(range_std_m)
    weight = 1 / (4 * variance_m2 * range_m**2 + 2 * variance_m2**2)
    fit = _fit(anchors_m, range_m, tag_height_m, range_std_m, weight, against_last=False)
    return _complete(anchors_m, range_m, fit, outlier_m)


def solve_paper(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float, outlier_m: float
) -> Fixes:
    """Weighted linear trilateration as [Following] has it: the last station's row is subtracted from the others.

    The paper's weight matrix is lost in its text. It is read as diag(1/d_i): near stations count more. What the rows
    share through the last station is left out of these weights (not out of the covariance). With three stations no
    weighting changes the 2-D fix: two equations, two unknowns. The last station is the last one heard at an epoch.
    """
    weight = 1 / np.maximum(range_m, range_std_m)
    fit = _fit(anchors_m, range_m, tag_height_m, range_std_m, weight, against_last=True)
    return _complete(anchors_m, range_m, fit, outlier_m)


def start_linear(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float
) -> tuple[Float, Float]:
    """For an iteration: (E, 3) positions as solve_linear has them, NaN where the anchors heard have no spread in m^2,
    and that spread (E,), as `spread_of` has it.
    """
    fit = _fit(anchors_m, range_m, tag_height_m, range_std_m, np.ones_like(range_m), against_last=False)
    return fit.position_m, fit.spread_m2


def spread_of(anchors_m: Float, heard: np.ndarray, solve_z: bool) -> Float:
    """(E,) mean square distance in m^2 of the anchors heard (E, A) from the line, in space the plane, that fits best.

    Taken as 1/trace(S^-1) of their scatter S, which is that where it is small:
    then it decides whether a fix differs from its mirror image.
    """
    n = heard.sum(axis=1)
    share = heard / np.maximum(n, 1)[:, None]
    x, y, z = (np.where(heard, each - (share @ each)[:, None], 0.0) for each in anchors_m.T)
    xx, xy, yy, xz, yz, zz = (_along(*pair) for pair in ((x, x), (x, y), (y, y), (x, z), (y, z), (z, z)))
    if solve_z:
        minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
        det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    else:
        minors, det = xx + yy, xx * yy - xy * xy
    flat = ~(minors > 0)
    return np.where(flat, 0.0, det / np.where(flat, 1.0, minors * n))


@dataclass(frozen=True, slots=True)
class _Fit:
    """Positions (E, 3) in map, (sum w b b^T)^-1 (E, D, D) with b = a - pivot, and the spread (E,) of the anchors heard.

    What is not spread is NaN. lever: D times (E, A), w b; noise_m4: (E, A) v of the rows; last_m4 (E,) of what all
    rows have in common, zero where that is none.
    """

    position_m: Float
    inverse: Float
    spread_m2: Float
    lever: list[Float]
    noise_m4: Float
    last_m4: Float


def _fit(
    anchors_m: Float,
    range_m: Float,
    tag_height_m: float | None,
    range_std_m: float,
    weight: Float,
    *,
    against_last: bool,
) -> _Fit:
    origin_m = anchors_m.mean(axis=0)
    if tag_height_m is not None:
        origin_m = np.append(origin_m[:2], tag_height_m)
    # About the centroid, so that maps with large coordinates lose no digits.
    around_m, heard, solve_z = anchors_m - origin_m, np.isfinite(range_m), tag_height_m is None
    axes = 3 if solve_z else 2
    variance_m2 = np.square(range_std_m)
    spread_m2 = np.where(heard.sum(axis=1) > axes, spread_of(anchors_m, heard, solve_z), 0.0)
    sharp = spread_m2 > SPREAD_OF_RANGE_STD**2 * variance_m2
    square_m2 = np.where(heard, range_m, 0.0) ** 2
    noise_m4 = 4 * variance_m2 * square_m2 + 2 * np.square(variance_m2)
    if not solve_z:
        square_m2 = np.maximum(square_m2 - around_m[:, 2] ** 2, 0.0)
    row_m2 = square_m2 - variance_m2 - (around_m[:, :axes] ** 2).sum(axis=1)

    weight = np.where(heard, weight, 0.0)
    pick = _last_heard(heard) if against_last else weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    offset = [np.where(heard, each - (pick @ each)[:, None], 0.0) for each in around_m.T[:axes]]
    pull = (_along(pick, row_m2)[:, None] - row_m2) / 2
    lever = [weight * each for each in offset]
    inverse = _invert([[_along(lever[i], offset[j]) for j in range(axes)] for i in range(axes)], sharp)
    position_m = np.full((len(range_m), 3), np.nan)
    position_m[:, :axes] = (inverse @ np.stack([_along(each, pull) for each in lever], axis=1)[:, :, None])[:, :, 0]
    if not solve_z:
        position_m[:, 2] = 0.0 * position_m[:, 0]
    last_m4 = _along(pick, noise_m4) if against_last else np.zeros(len(range_m))
    return _Fit(position_m + origin_m, inverse, spread_m2, lever, noise_m4, last_m4)


def _along(first: Float, second: Float) -> Float:
    """(E,) sums over the anchors of the products (E, A)."""
    return np.einsum("ea,ea->e", first, second)


def _last_heard(heard: np.ndarray) -> Float:
    """(E, A) one at the last anchor of each epoch: the row that is subtracted from all."""
    last = heard.shape[1] - 1 - np.argmax(heard[:, ::-1], axis=1)
    return np.where(heard & (np.arange(heard.shape[1]) == last[:, None]), 1.0, 0.0)


def _invert(normal: list[list[Float]], sharp: np.ndarray) -> Float:
    """(E, D, D) inverses of a symmetric matrix of (E,) each, NaN where not sharp."""
    (xx, xy), yy, axes = normal[0][:2], normal[1][1], len(normal)
    xz, yz, zz = (normal[0][2], normal[1][2], normal[2][2]) if axes == 3 else (0 * xx, 0 * xx, xx + yy)
    with np.errstate(divide="ignore", invalid="ignore"):
        told, ixx, ixy, iyy, ixz, iyz, izz = invert_normal(xx, xy, yy, xz, yz, zz)
    whole = np.stack([ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz], axis=1).reshape(-1, 3, 3)
    whole[~(told & sharp)] = np.nan
    return whole[:, :axes, :axes]


def _complete(anchors_m: Float, range_m: Float, fit: _Fit, outlier_m: float) -> Fixes:
    """Fixes with the covariance H^-1 (1/4 sum w^2 v b b^T) H^-1; the last row's own noise is in every difference.

    That adds v_n/4 (sum w b)(sum w b)^T; about the weighted mean the sum is zero.
    """
    axes = len(fit.lever)
    noise_m4 = np.empty((len(range_m), axes, axes))
    for i, first in enumerate(fit.lever):
        for j, second in enumerate(fit.lever):
            shared = fit.last_m4 * first.sum(axis=1) * second.sum(axis=1)
            noise_m4[:, i, j] = (_along(first * second, fit.noise_m4) + shared) / 4
    return complete_fixes(anchors_m, range_m, fit.position_m, fit.inverse @ noise_m4 @ fit.inverse, outlier_m)
