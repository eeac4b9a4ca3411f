"""What one epoch of ranges tells: a fix, its covariance and dilution of precision, its residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from quadlog.errors import AnchorsCollinear, MissingInput
from quadlog.messages import Float, Int
from quadlog.positioning.descent import gather_heard, invert_normal, normal_equations

SPREAD_OF_RANGE_STD = 0.5
"""Anchors nearer to one line than this share of a range's std (rms) cannot tell a fix from its mirror image."""


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


def predict_ranges(position_m: Float, anchors_m: Float, tag_height_m: float) -> Float:
    """(E, A) slant distances from positions (E, 2) at tag_height_m to anchors (A, 3)."""
    offset = position_m[:, None, :] - anchors_m[None, :, :2]
    return np.sqrt((offset**2).sum(axis=-1) + (tag_height_m - anchors_m[:, 2]) ** 2)


def complete_fixes(
    anchors_m: Float, range_m: Float, position_m: Float, covariance_m2: Float, outlier_m: float
) -> Fixes:
    """Fixes from the solutions of a method, with what is judged alike for all of them.

    position_m: (E, 3), covariance_m2: (E, D, D), NaN where there is no solution;
    D is 2 where the height was given and 3 where it was solved for. A solution
    where the directions to the anchors are all but parallel is none: degenerate.
    """
    residual_m, rms_m, hdop, n_ranges, xy_m, z_m, horizontal_m2, z_std_m = _judge(
        np.ascontiguousarray(anchors_m, dtype=np.float64),
        np.ascontiguousarray(range_m, dtype=np.float64),
        position_m,
        covariance_m2,
    )
    solved = np.isfinite(hdop)
    return Fixes(
        position_m=xy_m,
        covariance_m2=horizontal_m2,
        z_m=z_m,
        z_std_m=z_std_m,
        hdop=hdop,
        n_ranges=n_ranges,
        residual_rms_m=rms_m,
        residual_m=residual_m,
        solved=solved,
        degenerate=(n_ranges > covariance_m2.shape[1]) & ~solved,
        outlier=rms_m > outlier_m,
    )


@njit(cache=True, error_model="numpy")
def _judge(
    anchors_m: Float, range_m: Float, position_m: Float, covariance_m2: Float
) -> tuple[Float, Float, Float, Int, Float, Float, Float, Float]:
    """Residuals (E, A), their rms (E,), dilution (E,), number of ranges (E,), and the solutions that are sharp."""
    (n_epochs, n_anchors), solve_z = range_m.shape, covariance_m2.shape[1] == 3
    residual_m, xy_m = np.full((n_epochs, n_anchors), np.nan), np.full((n_epochs, 2), np.nan)
    rms_m, hdop = np.full(n_epochs, np.nan), np.full(n_epochs, np.nan)
    z_m, z_std_m = np.full(n_epochs, np.nan), np.full(n_epochs, np.nan)
    horizontal_m2, n_ranges = np.full((n_epochs, 2, 2), np.nan), np.zeros(n_epochs, dtype=np.int64)
    heard_m, heard = np.empty((n_anchors, 3)), np.empty(n_anchors)
    for e in range(n_epochs):
        x, y, z = position_m[e, 0], position_m[e, 1], position_m[e, 2]
        n = gather_heard(anchors_m, range_m, e, heard_m, heard)
        n_ranges[e] = n
        variance_m2 = covariance_m2[e, 0, 0] + covariance_m2[e, 1, 1] + (covariance_m2[e, 2, 2] if solve_z else 0.0)
        if not np.isfinite(x + y + z + variance_m2):
            continue
        normal = normal_equations(x, y, z, solve_z, heard_m, heard, n, np.inf, np.inf)
        inverse = invert_normal(*normal[:6])
        if not inverse[0]:
            continue
        hdop[e], rms_m[e] = np.sqrt(inverse[1] + inverse[3]), np.sqrt(normal[9] / n)
        xy_m[e, 0], xy_m[e, 1], z_m[e] = x, y, z
        z_std_m[e] = np.sqrt(covariance_m2[e, 2, 2]) if solve_z else 0.0
        for i in range(2):
            for j in range(2):
                horizontal_m2[e, i, j] = covariance_m2[e, i, j]
        for a in range(n_anchors):
            dx, dy, dz = x - anchors_m[a, 0], y - anchors_m[a, 1], z - anchors_m[a, 2]
            residual_m[e, a] = range_m[e, a] - np.sqrt(dx * dx + dy * dy + dz * dz)
    return residual_m, rms_m, hdop, n_ranges, xy_m, z_m, horizontal_m2, z_std_m
