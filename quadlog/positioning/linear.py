"""Linear fixes: squared ranges are linear in the position once the unknown |p|^2 is out of the way.

    d_i^2 - s_i^2 - |a_i|^2 = |p|^2 - 2 a_i . p,  with noise of variance v_i = 4 s_i^2 d_i^2 + 2 s_i^4

s is the std of a range, and s^2 what noise adds to a squared range on average: nothing where all stds are alike,
a bias where not. Differences of rows remove |p|^2. Subtracting one reference station's row from all others makes them
correlated; with C^-1 of these rows as weights the fix depends on no choice of reference, and equals the fit that
keeps |p|^2 as an unknown and weighs row i by 1/v_i: Sherman-Morrison, written down without a matrix of A x A.

Every solver takes anchors (A, 3), ranges (E, A), NaN where absent, the tag's height or None to solve for it, and the
std of the ranges, one or (A,). Its covariance is that of its own weights, not of the best there are.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.messages import Float
from quadlog.positioning.descent import invert_normal, spread_of, write_symmetric
from quadlog.positioning.fixes import SPREAD_OF_RANGE_STD, Fixes, complete_fixes


def solve_linear(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float | Float, outlier_m: float
) -> Fixes:
    """Least squares with every row alike, less their mean: no station is special."""
    fit = _fit(anchors_m, range_m, tag_height_m, range_std_m, np.ones_like(range_m), against_last=False)
    return _complete(anchors_m, range_m, fit, outlier_m)


def solve_weighted(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float | Float, outlier_m: float
) -> Fixes:
    """Weighted least squares with the full covariance C of the rows [Following, right form].

    Against reference station n, C = 4 [diag(s_i^2 d_i^2) + s_n^2 d_n^2 11^T] + 2 [diag(s_i^4) + s_n^4 11^T]
    and W = C^-1; here in the form that needs no reference.
    """
    variance_m2 = np.square(range_std_m)
    weight = 1 / (4 * variance_m2 * range_m**2 + 2 * variance_m2**2)
    fit = _fit(anchors_m, range_m, tag_height_m, range_std_m, weight, against_last=False)
    return _complete(anchors_m, range_m, fit, outlier_m)


def solve_paper(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float | Float, outlier_m: float
) -> Fixes:
    """Weighted linear trilateration as [Following] has it: the last station's row is subtracted from the others.

    The paper's weight matrix is lost in its text. It is read as diag(1/d_i):
    near stations count more. What the rows share through the last station is
    left out of these weights (not out of the covariance). With three stations
    no weighting changes the 2-D fix: two equations, two unknowns. The last
    station is the last one heard at an epoch.
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
    return fit[0], fit[3]


def _complete(anchors_m: Float, range_m: Float, fit: tuple[Float, Float, Float, Float], outlier_m: float) -> Fixes:
    position_m, inverse, noise, _ = fit
    return complete_fixes(anchors_m, range_m, position_m, inverse @ noise @ inverse, outlier_m)


def _fit(
    anchors_m: Float,
    range_m: Float,
    tag_height_m: float | None,
    range_std_m: float | Float,
    weight: Float,
    *,
    against_last: bool,
) -> tuple[Float, Float, Float, Float]:
    """Positions (E, 3) in map, what their covariance is made of, bread and filling (E, D, D), and the spread (E,)."""
    origin_m = anchors_m.mean(axis=0)
    if tag_height_m is not None:
        origin_m = np.append(origin_m[:2], tag_height_m)
    variance_m2 = np.ascontiguousarray(np.broadcast_to(np.square(range_std_m), len(anchors_m)), dtype=np.float64)
    # About the centroid, so that maps with large coordinates lose no digits.
    position_m, inverse, noise, spread_m2 = _fit_all(
        np.ascontiguousarray(anchors_m - origin_m, dtype=np.float64),
        np.ascontiguousarray(range_m, dtype=np.float64),
        tag_height_m is None,
        variance_m2,
        np.ascontiguousarray(weight, dtype=np.float64),
        against_last,
        SPREAD_OF_RANGE_STD**2 * float(variance_m2.mean()),
    )
    position_m += origin_m
    return position_m, inverse, noise, spread_m2


@njit(cache=True, error_model="numpy")
def _fit_all(
    anchors_m: Float,
    range_m: Float,
    solve_z: bool,
    variance_m2: Float,
    weight: Float,
    against_last: bool,
    least_m2: float,
) -> tuple[Float, Float, Float, Float]:
    """Positions, (sum w b b^T)^-1 and the variance of 1/2 sum w b y, with b = a - pivot; NaN where not spread."""
    n_epochs, n_anchors = range_m.shape
    unknowns = 3 if solve_z else 2
    position_m = np.full((n_epochs, 3), np.nan)
    inverse = np.full((n_epochs, unknowns, unknowns), np.nan)
    noise = np.full((n_epochs, unknowns, unknowns), np.nan)
    spread_m2 = np.zeros(n_epochs)
    rows, pivot = np.empty((n_anchors, 6)), np.empty(4)
    for e in range(n_epochs):
        n = _write_rows(rows, anchors_m, range_m, weight, e, solve_z, variance_m2)
        if n > unknowns:
            spread_m2[e] = spread_of(rows, n, solve_z)
        if not spread_m2[e] > least_m2:
            continue
        _choose_pivot(rows, n, against_last, pivot)
        sxx, sxy, syy, sxz, syz, szz, gx, gy, gz = _sum_rows(rows, n, pivot)
        ok, ixx, ixy, iyy, ixz, iyz, izz = invert_normal(sxx, sxy, syy, sxz, syz, szz if solve_z else sxx + syy)
        if not ok:
            continue
        position_m[e, 0] = ixx * gx + ixy * gy + ixz * gz
        position_m[e, 1] = ixy * gx + iyy * gy + iyz * gz
        position_m[e, 2] = ixz * gx + iyz * gy + izz * gz
        write_symmetric(inverse, e, ixx, ixy, iyy, ixz, iyz, izz)
        _sum_noise(rows, n, pivot, against_last, noise, e)
    return position_m, inverse, noise, spread_m2


@njit(cache=True, error_model="numpy")
def _write_rows(
    rows: Float, anchors_m: Float, range_m: Float, weight: Float, e: int, solve_z: bool, variance_m2: Float
) -> int:
    """How many ranges there are; each gives a row x, y, z, y_i, v_i, w_i. Where the height is given, every z is zero.

    That height is the origin's, and max(d^2 - dz^2, 0) the horizontal square.
    """
    n = 0
    for a in range(len(anchors_m)):
        if np.isfinite(range_m[e, a]):
            x, y, z, square = anchors_m[a, 0], anchors_m[a, 1], anchors_m[a, 2], range_m[e, a] ** 2
            rows[n, 4], rows[n, 5] = 4 * variance_m2[a] * square + 2 * variance_m2[a] ** 2, weight[e, a]
            if not solve_z:
                square, z = max(square - z * z, 0.0), 0.0
            rows[n, 0], rows[n, 1], rows[n, 2] = x, y, z
            rows[n, 3] = square - variance_m2[a] - x * x - y * y - z * z
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def _choose_pivot(rows: Float, n: int, against_last: bool, pivot: Float) -> None:
    """The row that is subtracted from all: the last one, or the weighted mean, as if |p|^2 were one more unknown."""
    total = 0.0
    for i in range(n):
        total += rows[i, 5]
    for k in range(4):
        pivot[k] = 0.0
        for i in range(n):
            pivot[k] += rows[i, 5] / total * rows[i, k]
        if against_last:
            pivot[k] = rows[n - 1, k]


@njit(cache=True, error_model="numpy")
def _sum_rows(
    rows: Float, n: int, pivot: Float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Sum of w b b^T as xx, xy, yy, xz, yz, zz, and -1/2 sum w b (y - y_pivot) as x, y, z."""
    sxx, sxy, syy, sxz, syz, szz, gx, gy, gz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        x, y, z, w = rows[i, 0] - pivot[0], rows[i, 1] - pivot[1], rows[i, 2] - pivot[2], rows[i, 5]
        sxx, sxy, syy = sxx + w * x * x, sxy + w * x * y, syy + w * y * y
        sxz, syz, szz = sxz + w * x * z, syz + w * y * z, szz + w * z * z
        pull = w * (pivot[3] - rows[i, 3]) / 2
        gx, gy, gz = gx + pull * x, gy + pull * y, gz + pull * z
    return sxx, sxy, syy, sxz, syz, szz, gx, gy, gz


@njit(cache=True, error_model="numpy")
def _sum_noise(rows: Float, n: int, pivot: Float, against_last: bool, noise: Float, e: int) -> None:
    """Row e of noise (E, D, D): 1/4 sum w^2 v b b^T, and where the last row is in every difference, its own noise.

    That is v_n/4 (sum w b)(sum w b)^T; about the weighted mean the sum is zero.
    """
    unknowns = noise.shape[1]
    last = rows[n - 1, 4] if against_last else 0.0
    for j in range(unknowns):
        for k in range(unknowns):
            own, lever_j, lever_k = 0.0, 0.0, 0.0
            for i in range(n):
                bj, bk, w = rows[i, j] - pivot[j], rows[i, k] - pivot[k], rows[i, 5]
                own += w * w * rows[i, 4] * bj * bk
                lever_j, lever_k = lever_j + w * bj, lever_k + w * bk
            noise[e, j, k] = (own + last * lever_j * lever_k) / 4
