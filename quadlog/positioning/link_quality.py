"""What the ranges between one tag and each anchor are worth: residuals, bias, and how often the way was blocked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.anchor_bias import AnchorBias
from quadlog.positioning.locate import RangeRows

NLOS_STD = 3.0
"""A range longer than predicted by so many std was late: its straight way was blocked."""
WEAK_FIRST_PATH_DB = 6.0
"""Receiver power this far above that of the first path is the radios' own hint of a blocked way."""


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """One tag's links to A anchors, in the order asked for; what a link has no ranges for is NaN.

    n: (A,) ranges on the track. residual_rms_m, residual_median_m: (A,) range less prediction, the applied
    bias taken out. nlos_share: (A,) of them late by more than NLOS_STD.
    bias_m, bias_std_m: (A,) as estimated, NaN where it was not. bias_applied: (A,) bool; why_not: A texts, empty
    where the bias is applied.
    """

    n: Int
    residual_rms_m: Float
    residual_median_m: Float
    nlos_share: Float
    bias_m: Float
    bias_std_m: Float
    bias_applied: np.ndarray
    why_not: tuple[str, ...]


def link_quality(
    rows: RangeRows,
    anchor_ids: Int,
    bias: AnchorBias | None,
    range_std_m: float,
    why_no_bias: str = "calibration is off",
) -> LinkQuality:
    """The links of a tag to anchors (A,), whose bias, in the same order, is None when it was not estimated."""
    count = len(anchor_ids)
    n = np.zeros(count, dtype=np.int64)
    rms_m, median_m, nlos_share = (np.full(count, np.nan) for _ in range(3))
    residual_m = rows.range_m - rows.predicted_m
    on_track = np.isfinite(residual_m)
    for index, anchor in enumerate(anchor_ids):
        mine_m = residual_m[on_track & (rows.anchor == anchor)]
        n[index] = len(mine_m)
        if len(mine_m):
            rms_m[index] = np.sqrt(np.mean(mine_m**2))
            median_m[index] = np.median(mine_m)
            nlos_share[index] = np.mean(mine_m > NLOS_STD * range_std_m)
    unknown = np.full(count, np.nan)
    return LinkQuality(
        n=n,
        residual_rms_m=rms_m,
        residual_median_m=median_m,
        nlos_share=nlos_share,
        bias_m=unknown if bias is None else bias.bias_m,
        bias_std_m=unknown if bias is None else bias.std_m,
        bias_applied=np.zeros(count, dtype=bool) if bias is None else bias.significant,
        why_not=(why_no_bias,) * count if bias is None else why_not_applied(bias),
    )


def why_not_applied(bias: AnchorBias) -> tuple[str, ...]:
    """For each link why its estimated bias is not subtracted, empty where it is."""
    heard = zip(bias.significant, bias.n > 0, strict=True)
    return tuple("" if applied else bias.reason if has_ranges else "no ranges" for applied, has_ranges in heard)


def weak_first_path_share(ranges: RangeSeries, gap_db: Float | None, tag: int, anchor_ids: Int) -> Float:
    """(A,) share of a tag's ranges whose gap (N,) of receiver to first-path power is above WEAK_FIRST_PATH_DB.

    NaN for links whose radios do not tell.
    """
    share = np.full(len(anchor_ids), np.nan)
    if gap_db is None:
        return share
    told = (ranges.tag == tag) & np.isfinite(gap_db)
    for index, anchor in enumerate(anchor_ids):
        mine_db = gap_db[told & (ranges.anchor == anchor)]
        if len(mine_db):
            share[index] = np.mean(mine_db > WEAK_FIRST_PATH_DB)
    return share
