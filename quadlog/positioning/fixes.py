"""What one epoch of ranges tells: a fix, its covariance and dilution of precision, its residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.errors import AnchorsCollinear, MissingInput
from quadlog.messages import Float, Int
from quadlog.positioning.descent import invert_normal

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
