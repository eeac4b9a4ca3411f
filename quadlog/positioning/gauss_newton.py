"""Maximum-likelihood fixes: Gauss-Newton on slant ranges, in 2-D with a known tag height."""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.messages import Float
from quadlog.positioning.fixes import SPREAD_OF_RANGE_STD, Fixes, predict_ranges


def solve_gauss_newton(
    anchors_m: Float, range_m: Float, tag_height_m: float, range_std_m: float, outlier_m: float
) -> Fixes:
    """Maximum-likelihood fixes from ranges (E, A), NaN where absent, to anchors (A, 3) in map.

    Starts at the linear solution and iterates u = (p - a)/|p - a|,
    dp = (sum u u^T)^-1 sum u (d - |p - a|) [Following, right form] with the full
    3-D distance, whose known height difference is the slant. A step that would
    raise the residuals is halved. The covariance is (sum u u^T / std^2)^-1, the
    Cramér-Rao bound. Fewer than three ranges, or anchors on a line, are not solved.
    """
    anchors_m = np.ascontiguousarray(anchors_m, dtype=np.float64)
    range_m = np.ascontiguousarray(range_m, dtype=np.float64)
    n_ranges = np.isfinite(range_m).sum(axis=1).astype(np.int64)
    position_m, covariance_m2, solved = _solve_all(anchors_m, range_m, float(tag_height_m), float(range_std_m))
    residual_m = range_m - predict_ranges(position_m, anchors_m, tag_height_m)
    with np.errstate(invalid="ignore"):
        rms_m = np.sqrt(np.nansum(residual_m**2, axis=1) / np.where(solved, n_ranges, np.nan))
    degenerate = (n_ranges >= 3) & ~solved
    outlier = solved & (np.nan_to_num(rms_m) > outlier_m)
    z_m, z_std_m = np.where(solved, tag_height_m, np.nan), np.where(solved, 0.0, np.nan)
    hdop = np.sqrt(np.trace(covariance_m2, axis1=1, axis2=2)) / range_std_m
    return Fixes(
        position_m, covariance_m2, z_m, z_std_m, hdop, n_ranges, rms_m, residual_m, solved, degenerate, outlier
    )


@njit(cache=True)
def _solve_all(anchors_m: Float, range_m: Float, height_m: float, std_m: float) -> tuple[Float, Float, np.ndarray]:
    n_epochs, n_anchors = range_m.shape
    position_m = np.full((n_epochs, 2), np.nan)
    covariance_m2 = np.full((n_epochs, 2, 2), np.nan)
    solved = np.zeros(n_epochs, dtype=np.bool_)
    ax, ay, dz2, d = np.empty(n_anchors), np.empty(n_anchors), np.empty(n_anchors), np.empty(n_anchors)
    for e in range(n_epochs):
        m = 0
        for a in range(n_anchors):
            if np.isfinite(range_m[e, a]):
                ax[m], ay[m], d[m] = anchors_m[a, 0], anchors_m[a, 1], range_m[e, a]
                dz2[m] = (anchors_m[a, 2] - height_m) ** 2
                m += 1
        if m < 3:
            continue
        ok, x, y = _linear_solution(ax[:m], ay[:m], dz2[:m], d[:m], (SPREAD_OF_RANGE_STD * std_m) ** 2)
        if not ok:
            continue
        ok, x, y, hxx, hxy, hyy = _gauss_newton(x, y, ax[:m], ay[:m], dz2[:m], d[:m])
        if not ok:
            continue
        scale = std_m**2 / (hxx * hyy - hxy * hxy)
        position_m[e, 0], position_m[e, 1] = x, y
        covariance_m2[e, 0, 0], covariance_m2[e, 1, 1] = scale * hyy, scale * hxx
        covariance_m2[e, 0, 1] = covariance_m2[e, 1, 0] = -scale * hxy
        solved[e] = True
    return position_m, covariance_m2, solved


@njit(cache=True)
def _linear_solution(ax: Float, ay: Float, dz2: Float, d: Float, spread_m2: float) -> tuple[bool, float, float]:
    """Squared horizontal ranges minus their mean are linear in the position; False where the anchors lie on a line.

    Taking the mean away instead of one station's row makes no station special.
    """
    m = len(ax)
    cx, cy = ax.mean(), ay.mean()
    rhs = np.empty(m)
    for i in range(m):
        # About the centroid, so that maps with large coordinates lose no digits.
        rhs[i] = ((ax[i] - cx) ** 2 + (ay[i] - cy) ** 2 - max(d[i] ** 2 - dz2[i], 0.0)) / 2
    rhs -= rhs.mean()
    sxx, sxy, syy, bx, by = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(m):
        ux, uy = ax[i] - cx, ay[i] - cy
        sxx, sxy, syy = sxx + ux * ux, sxy + ux * uy, syy + uy * uy
        bx, by = bx + ux * rhs[i], by + uy * rhs[i]
    narrow = (sxx + syy) / 2 - np.sqrt(((sxx - syy) / 2) ** 2 + sxy * sxy)
    if narrow / m < spread_m2:
        return False, 0.0, 0.0
    det = sxx * syy - sxy * sxy
    return True, cx + (syy * bx - sxy * by) / det, cy + (sxx * by - sxy * bx) / det


@njit(cache=True)
def _normal_equations(
    x: float, y: float, ax: Float, ay: Float, dz2: Float, d: Float
) -> tuple[float, float, float, float, float, float]:
    """H = sum u u^T as (xx, xy, yy), b = sum u r as (x, y), and the cost sum r^2."""
    hxx, hxy, hyy, bx, by, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(ax)):
        dx, dy = x - ax[i], y - ay[i]
        distance = max(np.sqrt(dx * dx + dy * dy + dz2[i]), 1e-9)
        ux, uy, r = dx / distance, dy / distance, d[i] - distance
        hxx, hxy, hyy = hxx + ux * ux, hxy + ux * uy, hyy + uy * uy
        bx, by, cost = bx + ux * r, by + uy * r, cost + r * r
    return hxx, hxy, hyy, bx, by, cost


@njit(cache=True)
def _gauss_newton(
    x: float, y: float, ax: Float, ay: Float, dz2: Float, d: Float
) -> tuple[bool, float, float, float, float, float]:
    """The minimum of sum (d - |p - a|)^2 downhill from (x, y), and H there; False where there is no sharp one."""
    hxx, hxy, hyy, bx, by, cost = _normal_equations(x, y, ax, ay, dz2, d)
    for _ in range(100):
        det = hxx * hyy - hxy * hxy
        # Directions to the anchors all but parallel: the fix could slide along a line.
        if not det > 1e-6 * (hxx + hyy) ** 2:
            return False, x, y, hxx, hxy, hyy
        step_x, step_y = (hyy * bx - hxy * by) / det, (hxx * by - hxy * bx) / det
        share = 1.0
        for _ in range(30):
            trial = _normal_equations(x + share * step_x, y + share * step_y, ax, ay, dz2, d)
            if trial[5] <= cost:
                break
            share /= 2
        if trial[5] > cost:
            # Not even a tiny step goes down: this is the minimum, to the last digit.
            return True, x, y, hxx, hxy, hyy
        x, y = x + share * step_x, y + share * step_y
        hxx, hxy, hyy, bx, by, cost = trial
        if share * (abs(step_x) + abs(step_y)) < 1e-6:
            det = hxx * hyy - hxy * hxy
            return det > 1e-6 * (hxx + hyy) ** 2, x, y, hxx, hxy, hyy
    return False, x, y, hxx, hxy, hyy
