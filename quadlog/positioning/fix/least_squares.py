"""Compiled descent to the fix that fits the ranges of one epoch best; every iterative solver walks it. And what a fix
is.

The unknown is (x, y) or, with `solve_z`, (x, y, z). Where z is given it is frozen, so that slant ranges need no
other model. Everything here runs once per fix, which is why it is compiled and written out in components.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadlog.compiled import inner, kernel
from quadlog.errors import AnchorsCollinear, MissingInput
from quadlog.messages import Float, Int

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

    free_z: one, or zero where z is given. A residual d - |p - a| beyond long_m, or below -short_m, counts as Huber has
    it: its cost grows linearly and its weight falls as 1/residual. Infinite limits make it least squares. The cost is
    sum r^2 where nothing is beyond.
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


SPREAD_OF_RANGE_STD = 0.5
"""Anchors nearer to one line than this share of a range's std (rms) cannot distinguish a fix from its mirror image."""


@dataclass(frozen=True, slots=True)
class Fixes:
    """One row per epoch; numbers of a row that is not solved are NaN.

    position_m: (E, 2) in map; covariance_m2: (E, 2, 2) of it.
    z_m, z_std_m: (E,) height in map; where it was given instead of solved for, that, and a std of zero.
    hdop: (E,) horizontal dilution of precision: sqrt(trace) of the smallest covariance there is at that place,
    (sum u u^T)^-1, whatever the method. Without unit: times the range std it is the Cramér-Rao bound.
    residual_m: (E, A) measured minus predicted, NaN where there is no range; residual_rms_m: (E,).
    n_ranges: (E,); solved: (E,) bool; degenerate: (E,) bool, enough ranges, but from anchors on a line or with
    no unique minimum nearby; outlier: (E,) bool, solved with a residual rms above the limit.
    """

    position_m: Float
    covariance_m2: Float
    z_m: Float
    z_std_m: Float
    hdop: Float
    n_ranges: Int
    residual_rms_m: Float
    residual_m: Float
    solved: np.ndarray
    degenerate: np.ndarray
    outlier: np.ndarray


def require_spread(anchor_ids: Int, anchors_m: Float, range_std_m: float) -> None:
    """Refuse anchors (A, 3) that can give no unique fix, whatever they measure.

    Raises MissingInput for fewer than three, AnchorsCollinear where all lie on one line.
    """
    if len(anchors_m) < 3:
        raise MissingInput(
            "position", f"{len(anchors_m)} UWB anchors are known, a fix needs three", "add [[uwb.anchors]]"
        )
    centred = anchors_m[:, :2] - anchors_m[:, :2].mean(axis=0)
    off_line_m = float(np.linalg.svd(centred, compute_uv=False)[-1]) / np.sqrt(len(centred))
    if off_line_m < SPREAD_OF_RANGE_STD * range_std_m:
        raise AnchorsCollinear([int(i) for i in anchor_ids], off_line_m)


def complete_fixes(
    anchors_m: Float, range_m: Float, position_m: Float, covariance_m2: Float, outlier_m: float
) -> Fixes:
    """Fixes from the solutions of a method, with what is judged alike for all of them.

    position_m: (E, 3), covariance_m2: (E, D, D), NaN where there is no solution; D is 2 where the height was given and
    3 where it was solved for. A solution where the directions to the anchors are all but parallel is none: degenerate.
    """
    heard = np.isfinite(range_m)
    n_ranges, axes = heard.sum(axis=1), covariance_m2.shape[1]
    variance_m2 = np.einsum("eii->e", covariance_m2)
    offset_m = position_m[:, None, :] - anchors_m
    distance_m = np.sqrt(np.einsum("eai,eai->ea", offset_m, offset_m))
    known = np.isfinite(position_m.sum(axis=1) + variance_m2)
    hdop = np.where(known, _dilution(offset_m, distance_m, heard, axes), np.nan)
    solved = np.isfinite(hdop)
    blank = np.where(solved, 0.0, np.nan)
    residual_m = range_m - distance_m + blank[:, None]
    rms_m = np.sqrt(np.where(heard, residual_m**2, 0.0).sum(axis=1) / np.maximum(n_ranges, 1)) + blank
    return Fixes(
        position_m=position_m[:, :2] + blank[:, None],
        covariance_m2=covariance_m2[:, :2, :2] + blank[:, None, None],
        z_m=position_m[:, 2] + blank,
        z_std_m=np.sqrt(covariance_m2[:, 2, 2] + blank) if axes == 3 else blank,
        hdop=hdop,
        n_ranges=n_ranges,
        residual_rms_m=rms_m,
        residual_m=residual_m,
        solved=solved,
        degenerate=(n_ranges > axes) & ~solved,
        outlier=rms_m > outlier_m,
    )


def _dilution(offset_m: Float, distance_m: Float, heard: np.ndarray, axes: int) -> Float:
    """(E,) root of the horizontal trace of (sum u u^T)^-1 of the ranges heard (E, A), NaN where that is not sharp."""
    told, inverse = invert_directions(offset_m / np.maximum(distance_m, 1e-9)[:, :, None], heard, axes)
    return np.sqrt(np.where(told, inverse[0] + inverse[2], np.nan))


def invert_directions(direction: Float, heard: np.ndarray, axes: int) -> tuple[np.ndarray, list[Float]]:
    """Whether (sum u u^T)^-1 of directions (E, A, 3) is sharp (E,), and its xx, xy, yy, xz, yz, zz.

    Summed over those heard (E, A), in two axes or three.
    """
    x, y, z = (np.where(heard, direction[:, :, i], 0.0) for i in range(3))
    xx, xy, yy, xz, yz, zz = (np.einsum("ea,ea->e", *pair) for pair in ((x, x), (x, y), (y, y), (x, z), (y, z), (z, z)))
    if axes == 2:
        xz, yz, zz = 0 * xz, 0 * yz, xx + yy
    with np.errstate(divide="ignore", invalid="ignore"):
        told, *inverse = invert_normal(xx, xy, yy, xz, yz, zz)
    return told, inverse
