"""What one epoch of ranges tells: a fix, its covariance and dilution of precision, its residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.errors import AnchorsCollinear, MissingInput
from quadlog.messages import Float, Int

SPREAD_OF_RANGE_STD = 0.5
"""Anchors nearer to one line than this share of a range's std (rms) cannot tell a fix from its mirror image."""


@dataclass(frozen=True, slots=True)
class Fixes:
    """One row per epoch; numbers of a row that is not solved are NaN.

    position_m: (E, 2) in map; covariance_m2: (E, 2, 2) of it.
    z_m, z_std_m: (E,) height in map; where it was given instead of solved for, that, and a std of zero.
    hdop: (E,) horizontal dilution of precision, sqrt(trace(covariance)) / range std with every range trusted alike.
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
