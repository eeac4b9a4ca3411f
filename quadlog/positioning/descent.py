"""Compiled descent to the fix that fits the ranges of one epoch best; every iterative solver walks it.

The unknown is (x, y) or, with `solve_z`, (x, y, z). Where z is given it is frozen, so that slant ranges need no
other model. Everything here runs once per fix, which is why it is compiled and written out in components.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.messages import Float

SHARP = 1e-6
"""Smallest over largest eigenvalue of sum u u^T, roughly; below it the fix could slide along a line."""
MAX_STEPS = 100
RESTED_M, RESTED = 1e-6, 1e-8
"""A step, or a share of the cost, too small to matter to a fix."""
FLAT = 1e-4
"""Two late ranges can leave Huber's cost all but flat between two places. What still gains less when the steps are used
up is as good as the minimum."""
Normal = tuple[float, float, float, float, float, float, float, float, float, float]
"""H = sum w u u^T as xx, xy, yy, xz, yz, zz, then the gradient sum w u r as x, y, z, then the cost."""


@njit(cache=True, error_model="numpy")
def normal_equations(
    x: float, y: float, z: float, solve_z: bool, anchors_m: Float, d: Float, n: int, long_m: float, short_m: float
) -> Normal:
    """Normal equations at (x, y, z) of the first n ranges of d (A,) to anchors (A, 3).

    A residual d - |p - a| beyond long_m, or below -short_m, counts as Huber has
    it: its cost grows linearly and its weight falls as 1/residual. Infinite
    limits make it least squares. The cost is sum r^2 where nothing is beyond.
    """
    hxx, hxy, hyy, hxz, hyz, hzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    bx, by, bz, cost = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        dx, dy, dz = x - anchors_m[i, 0], y - anchors_m[i, 1], z - anchors_m[i, 2]
        distance = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        r = d[i] - distance
        limit = long_m if r > 0 else short_m
        if abs(r) > limit:
            w = limit / abs(r)
            cost += limit * (2 * abs(r) - limit)
        else:
            w = 1.0
            cost += r * r
        inverse = 1 / distance
        ux, uy, pull = dx * inverse, dy * inverse, w * r
        hxx, hxy, hyy = hxx + w * ux * ux, hxy + w * ux * uy, hyy + w * uy * uy
        bx, by = bx + pull * ux, by + pull * uy
        if solve_z:
            uz = dz * inverse
            hxz, hyz, hzz, bz = hxz + w * ux * uz, hyz + w * uy * uz, hzz + w * uz * uz, bz + pull * uz
    if not solve_z:
        hzz = hxx + hyy
    return hxx, hxy, hyy, hxz, hyz, hzz, bx, by, bz, cost


@njit(cache=True, error_model="numpy")
def invert_normal(
    hxx: float, hxy: float, hyy: float, hxz: float, hyz: float, hzz: float
) -> tuple[bool, float, float, float, float, float, float]:
    """H^-1 as xx, xy, yy, xz, yz, zz; False where H is all but singular."""
    cxx, cxy, cyy = hyy * hzz - hyz * hyz, hxz * hyz - hxy * hzz, hxx * hzz - hxz * hxz
    cxz, cyz, czz = hxy * hyz - hxz * hyy, hxy * hxz - hxx * hyz, hxx * hyy - hxy * hxy
    det = hxx * cxx + hxy * cxy + hxz * cxz
    if not det > SHARP * (hxx + hyy + hzz) * (cxx + cyy + czz):
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    s = 1 / det
    return True, s * cxx, s * cxy, s * cyy, s * cxz, s * cyz, s * czz


@njit(cache=True, error_model="numpy")
def write_symmetric(matrices: Float, e: int, xx: float, xy: float, yy: float, xz: float, yz: float, zz: float) -> None:
    """Into row e of (E, 3, 3), or the part of it that (E, 2, 2) has."""
    matrices[e, 0, 0], matrices[e, 0, 1], matrices[e, 1, 0], matrices[e, 1, 1] = xx, xy, xy, yy
    if matrices.shape[1] == 3:
        matrices[e, 0, 2], matrices[e, 2, 0], matrices[e, 1, 2], matrices[e, 2, 1] = xz, xz, yz, yz
        matrices[e, 2, 2] = zz


@njit(cache=True, error_model="numpy")
def spread_of(anchors_m: Float, n: int, solve_z: bool) -> float:
    """Mean square distance in m^2 of the first n anchors (A, 3) from the line, in space the plane, that fits them best.

    Taken as 1/trace(S^-1) of their scatter S, which is that where it is small:
    then it decides whether a fix can be told from its mirror image.
    """
    xx, xy, yy, xz, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    cx, cy, cz = 0.0, 0.0, 0.0
    for i in range(n):
        cx, cy, cz = cx + anchors_m[i, 0] / n, cy + anchors_m[i, 1] / n, cz + anchors_m[i, 2] / n
    for i in range(n):
        x, y, z = anchors_m[i, 0] - cx, anchors_m[i, 1] - cy, anchors_m[i, 2] - cz
        xx, xy, yy, xz, yz, zz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z, zz + z * z
    if solve_z:
        minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
        det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    else:
        minors, det = xx + yy, xx * yy - xy * xy
    return det / (minors * n) if minors > 0 else 0.0


@njit(cache=True, error_model="numpy")
def descend(
    x: float, y: float, z: float, solve_z: bool, anchors_m: Float, d: Float, n: int, long_m: float, short_m: float
) -> tuple[bool, float, float, float, Normal]:
    """The minimum downhill from (x, y, z) and the normal equations there; False where there is no sharp one.

    Gauss-Newton, reweighted at every step; a step that would raise the cost is halved.
    """
    normal = normal_equations(x, y, z, solve_z, anchors_m, d, n, long_m, short_m)
    gain = np.inf
    for _ in range(MAX_STEPS):
        bx, by, bz, cost = normal[6], normal[7], normal[8], normal[9]
        ok, ixx, ixy, iyy, ixz, iyz, izz = invert_normal(*normal[:6])
        if not ok:
            return False, x, y, z, normal
        sx, sy, sz = ixx * bx + ixy * by + ixz * bz, ixy * bx + iyy * by + iyz * bz, 0.0
        if solve_z:
            sz = ixz * bx + iyz * by + izz * bz
        share = 1.0
        for _ in range(30):
            trial = normal_equations(
                x + share * sx, y + share * sy, z + share * sz, solve_z, anchors_m, d, n, long_m, short_m
            )
            if trial[9] <= cost:
                break
            share /= 2
        if trial[9] > cost:
            # Not even a tiny step goes down: this is the minimum, to the last digit.
            return True, x, y, z, normal
        x, y, z, normal = x + share * sx, y + share * sy, z + share * sz, trial
        gain = (cost - normal[9]) / max(cost, 1e-300)
        if gain < RESTED or share * (abs(sx) + abs(sy) + abs(sz)) < RESTED_M:
            return True, x, y, z, normal
    return gain < FLAT, x, y, z, normal


@njit(cache=True, error_model="numpy")
def gather_heard(anchors_m: Float, range_m: Float, e: int, heard_m: Float, heard: Float) -> int:
    """How many ranges row e of (E, A) has; they and their anchors go to the front of heard (A,), heard_m (A, 3)."""
    n = 0
    for a in range(len(anchors_m)):
        if np.isfinite(range_m[e, a]):
            heard_m[n, 0], heard_m[n, 1], heard_m[n, 2] = anchors_m[a, 0], anchors_m[a, 1], anchors_m[a, 2]
            heard[n] = range_m[e, a]
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def descend_all(
    anchors_m: Float, range_m: Float, start_m: Float, solve_z: bool, long_m: float, short_m: float
) -> tuple[Float, Float, Float]:
    """Downhill from start_m (E, 3) in ranges (E, A): positions (E, 3), (sum w u u^T)^-1 (E, D, D) and costs (E,).

    D is 3 with solve_z, else 2. NaN where the start is NaN or there is no sharp minimum; the cost is infinite there.
    """
    n_epochs, n_anchors = range_m.shape
    unknowns = 3 if solve_z else 2
    position_m = np.full((n_epochs, 3), np.nan)
    inverse = np.full((n_epochs, unknowns, unknowns), np.nan)
    cost_m2 = np.full(n_epochs, np.inf)
    heard_m, heard = np.empty((n_anchors, 3)), np.empty(n_anchors)
    for e in range(n_epochs):
        x, y, z = start_m[e, 0], start_m[e, 1], start_m[e, 2]
        if not np.isfinite(x + y + z):
            continue
        n = gather_heard(anchors_m, range_m, e, heard_m, heard)
        ok, x, y, z, normal = descend(x, y, z, solve_z, heard_m, heard, n, long_m, short_m)
        if not ok:
            continue
        ok, ixx, ixy, iyy, ixz, iyz, izz = invert_normal(*normal[:6])
        if not ok:
            continue
        position_m[e, 0], position_m[e, 1], position_m[e, 2] = x, y, z
        write_symmetric(inverse, e, ixx, ixy, iyy, ixz, iyz, izz)
        cost_m2[e] = normal[9]
    return position_m, inverse, cost_m2
