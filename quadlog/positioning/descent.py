"""Compiled descent to the fix that fits the ranges of one epoch best; every iterative solver walks it.

The unknown is (x, y) or, with `solve_z`, (x, y, z). Where z is given it is frozen, so that slant ranges need no
other model. Everything here runs once per fix, which is why it is compiled and written out in components.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from quadlog.compiled import inner, kernel
from quadlog.messages import Float

SHARP = 1e-6
"""Smallest over largest eigenvalue of sum u u^T, roughly; below it the fix could slide along a line."""
MAX_STEPS = 100
HALVINGS = 30
RESTED_M, RESTED = 1e-6, 1e-8
"""A step, or a share of the cost, too small to matter to a fix."""
FLAT = 1e-4
"""Two late ranges can leave Huber's cost all but flat between two places. What still gains less when the steps are used
up is as good as the minimum."""
Normal = tuple[float, float, float, float, float, float, float, float, float, float]
"""H = sum w u u^T as xx, xy, yy, xz, yz, zz, then the gradient sum w u r as x, y, z, then the cost."""


@inner
def normal_equations(
    x: float, y: float, z: float, free_z: float, anchors_m: Float, range_m: Float, e: int, long_m: float, short_m: float
) -> Normal:
    """Normal equations at (x, y, z) of the ranges that row e of (E, A) has to anchors (A, 3).

    free_z: one, or zero where z is given. A residual d - |p - a| beyond long_m,
    or below -short_m, counts as Huber has it: its cost grows linearly and its
    weight falls as 1/residual. Infinite limits make it least squares. The cost
    is sum r^2 where nothing is beyond.
    """
    hxx, hxy, hyy, hxz, hyz, hzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    bx, by, bz, cost = 0.0, 0.0, 0.0, 0.0
    for i in range(len(anchors_m)):
        measured_m = range_m[e, i]
        if not math.isfinite(measured_m):
            continue
        dx, dy, dz = x - anchors_m[i, 0], y - anchors_m[i, 1], z - anchors_m[i, 2]
        distance = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        r = measured_m - distance
        size, limit, w = abs(r), long_m if r > 0 else short_m, 1.0
        if size > limit:
            w = limit / size
            cost += limit * (2 * size - limit)
        else:
            cost += r * r
        inverse = 1 / distance
        ux, uy, uz, pull = dx * inverse, dy * inverse, free_z * dz * inverse, w * r
        hxx, hxy, hyy = hxx + w * ux * ux, hxy + w * ux * uy, hyy + w * uy * uy
        hxz, hyz, hzz = hxz + w * ux * uz, hyz + w * uy * uz, hzz + w * uz * uz
        bx, by, bz = bx + pull * ux, by + pull * uy, bz + pull * uz
    return hxx, hxy, hyy, hxz, hyz, hzz + (1 - free_z) * (hxx + hyy), bx, by, bz, cost


def invert_normal(hxx: Any, hxy: Any, hyy: Any, hxz: Any, hyz: Any, hzz: Any) -> tuple[Any, ...]:
    """H^-1 as xx, xy, yy, xz, yz, zz, after whether it means anything: not where H is all but singular.

    Of numbers or, element by element, of arrays.
    """
    cxx, cxy, cyy = hyy * hzz - hyz * hyz, hxz * hyz - hxy * hzz, hxx * hzz - hxz * hxz
    cxz, cyz, czz = hxy * hyz - hxz * hyy, hxy * hxz - hxx * hyz, hxx * hyy - hxy * hxy
    det = hxx * cxx + hxy * cxy + hxz * cxz
    sharp = det > SHARP * (hxx + hyy + hzz) * (cxx + cyy + czz)
    s = 1 / det
    return sharp, s * cxx, s * cxy, s * cyy, s * cxz, s * cyz, s * czz


invert_one = kernel(invert_normal)


def descend_all(
    anchors_m: Float, range_m: Float, start_m: Float, solve_z: bool, long_m: float, short_m: float
) -> tuple[Float, Float, Float]:
    """Downhill from start_m (E, 3) in ranges (E, A): positions (E, 3), (sum w u u^T)^-1 (E, D, D) and costs (E,).

    D is 3 with solve_z, else 2. NaN where the start is NaN or there is no sharp minimum; the cost is infinite there.
    """
    n_epochs = len(range_m)
    position_m, inverse = np.full((n_epochs, 3), np.nan), np.full((n_epochs, 9), np.nan)
    cost_m2 = np.full(n_epochs, np.inf)
    _descend_rows(
        np.ascontiguousarray(anchors_m, dtype=np.float64),
        np.ascontiguousarray(range_m, dtype=np.float64),
        np.ascontiguousarray(start_m, dtype=np.float64),
        float(solve_z),
        float(long_m),
        float(short_m),
        position_m,
        inverse,
        cost_m2,
    )
    axes = 3 if solve_z else 2
    return position_m, inverse.reshape(-1, 3, 3)[:, :axes, :axes], cost_m2


@kernel
def _descend_rows(
    anchors_m: Float,
    range_m: Float,
    start_m: Float,
    free_z: float,
    long_m: float,
    short_m: float,
    position_m: Float,
    inverse: Float,
    cost_m2: Float,
) -> None:
    """Gauss-Newton for each row, reweighted at every step; a step that would raise the cost is halved.

    Where not even a tiny step goes down, that is the minimum, to the last digit.
    """
    for e in range(len(range_m)):
        x, y, z = start_m[e, 0], start_m[e, 1], start_m[e, 2]
        sx, sy, sz, share, cost, gain = 0.0, 0.0, 0.0, 1.0, math.inf, math.inf
        ixx, ixy, iyy, ixz, iyz, izz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        sharp, rested, steps, halvings = math.isfinite(x + y + z), False, 0, 0
        while sharp and not rested and steps <= MAX_STEPS:
            tx, ty, tz = x + share * sx, y + share * sy, z + share * sz
            normal = normal_equations(tx, ty, tz, free_z, anchors_m, range_m, e, long_m, short_m)
            hxx, hxy, hyy, hxz, hyz, hzz, bx, by, bz, trial = normal
            if not trial <= cost:
                share, halvings = share / 2, halvings + 1
                rested = halvings == HALVINGS
                continue
            gain, x, y, z = (cost - trial) / max(cost, 1e-300), tx, ty, tz
            small = share * (abs(sx) + abs(sy) + abs(sz)) < RESTED_M
            rested = steps > 0 and (gain < RESTED or small)
            sharp, ixx, ixy, iyy, ixz, iyz, izz = invert_one(hxx, hxy, hyy, hxz, hyz, hzz)
            sx, sy, sz = ixx * bx + ixy * by + ixz * bz, ixy * bx + iyy * by + iyz * bz, ixz * bx + iyz * by + izz * bz
            share, cost, steps, halvings = 1.0, trial, steps + 1, 0
            sz *= free_z
        if sharp and (rested or gain < FLAT):
            found = (x, y, z)
            for i in range(3):
                position_m[e, i] = found[i]
            whole = (ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz)
            for i in range(9):
                inverse[e, i] = whole[i]
            cost_m2[e] = cost
