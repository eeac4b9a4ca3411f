"""What the ranges between one tag and each anchor are worth: bias, residuals, how often the way was blocked, and what
the track would be without them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.batch.solve import Estimate, posterior_of_globals

NLOS_STD = 3.0
"""A range longer than predicted by so many std was late: its straight way was blocked."""
WEAK_FIRST_PATH_DB = 6.0
"""Receiver power this far above that of the first path is the radios' own hint of a blocked way."""

COMMON_STD_M = 0.2
LINK_STDS_M = (0.0, 0.002, 0.02, 0.05)
PRIORS = ("no biases", "one bias of all links", "one of all links, and small ones of each", "a bias of each link")
"""Biases that are possible a priori, and the std of those of each link; real sets lie within 0 and 0.4 m, and links of
one make share most of it."""
NO_BIAS_M = 1e-3


def bias_priors(n_links: int, calibrate: bool) -> Float:
    """(P, L, L) covariances of the links' biases that are possible a priori; without calibration the first two."""
    found = []
    for link_std_m in LINK_STDS_M if calibrate else LINK_STDS_M[:2]:
        common_m = COMMON_STD_M if link_std_m else NO_BIAS_M
        found.append(common_m**2 + max(link_std_m, NO_BIAS_M) ** 2 * np.eye(n_links))
    return np.array(found)


@dataclass(frozen=True, slots=True)
class RangeRows:
    """The N usable ranges of one tag.

    range_m: as measured; predicted_m: from the track, bias included, NaN off the track.
    weight: robust weight in the track, one for full trust, near zero for NLOS, zero off the track.
    """

    t_ns: Int
    anchor: Int
    range_m: Float
    predicted_m: Float
    weight: Float


@dataclass(frozen=True, slots=True)
class AnchorBias:
    """Measured minus true range of one tag's links to A anchors, as estimated with its track.

    bias_m, std_m: (A,); n: (A,) ranges of each link in the log. shares: (P,) of each of PRIORS in the estimate, by how
    likely the ranges are under it.
    """

    bias_m: Float
    std_m: Float
    n: Int
    shares: Float

    @property
    def applied(self) -> np.ndarray:
        """(A,) bool, the links that are corrected: all that were heard."""
        heard: np.ndarray = self.n > 0
        return heard

    @property
    def applied_m(self) -> Float:
        """(A,) what to subtract from the ranges: the biases of the links that were heard, zero elsewhere."""
        return np.where(self.applied, self.bias_m, 0.0)

    @property
    def reason(self) -> str:
        """What the ranges say about biases as a whole."""
        best = int(np.argmax(self.shares))
        return f"the ranges favour {PRIORS[best]} ({self.shares[best]:.0%})"


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


def link_quality(rows: RangeRows, anchor_ids: Int, bias: AnchorBias | None, range_std_m: float) -> LinkQuality:
    """The links of a tag to anchors (A,), whose bias, in the same order, is None when it was not estimated."""
    count = len(anchor_ids)
    n = np.zeros(count, dtype=np.int64)
    rms_m, median_m, nlos_share, unknown = (np.full(count, np.nan) for _ in range(4))
    residual_m = rows.range_m - rows.predicted_m
    on_track = np.isfinite(residual_m)
    for index, anchor in enumerate(anchor_ids):
        mine_m = residual_m[on_track & (rows.anchor == anchor)]
        n[index] = len(mine_m)
        if len(mine_m):
            rms_m[index] = np.sqrt(np.mean(mine_m**2))
            median_m[index] = np.median(mine_m)
            nlos_share[index] = np.mean(mine_m > NLOS_STD * range_std_m)
    applied = np.zeros(count, dtype=bool) if bias is None else bias.applied
    why_not = "calibration is off" if bias is None else "no ranges"
    return LinkQuality(
        n=n,
        residual_rms_m=rms_m,
        residual_median_m=median_m,
        nlos_share=nlos_share,
        bias_m=unknown if bias is None else bias.bias_m,
        bias_std_m=unknown if bias is None else bias.std_m,
        bias_applied=applied,
        why_not=tuple("" if each else why_not for each in applied),
    )


def weak_first_path_share(ranges: RangeSeries, gap_db: Float | None, tag: int, anchor_ids: Int) -> Float:
    """(A,) share of a tag's ranges whose gap (N,) of receiver to first-path power is above WEAK_FIRST_PATH_DB.

    NaN for links whose radios do not report it.
    """
    share = np.full(len(anchor_ids), np.nan)
    if gap_db is None:
        return share
    known = (ranges.tag == tag) & np.isfinite(gap_db)
    for index, anchor in enumerate(anchor_ids):
        mine_db = gap_db[known & (ranges.anchor == anchor)]
        if len(mine_db):
            share[index] = np.mean(mine_db > WEAK_FIRST_PATH_DB)
    return share


RARE_SHARE = 0.05
"""Anchors with fewer ranges than this share of the busiest one's are not left out."""


@dataclass(frozen=True, slots=True)
class Deleted:
    """Without each of G anchors: knots (G, K, 2, D) and globals (G, M), one Newton step from the estimate."""

    anchors: np.ndarray
    knots: Float
    values: Float

    def variances(self) -> Float:
        """(K, D) of the knots' coordinates: jackknife, (m - 1)/m sum (q - mean)^2, less what it overstates.

        Each of m anchors has a share of 2/m in a place.
        """
        off, m = self.knots[:, :, 0] - self.knots[:, :, 0].mean(axis=0), len(self.knots)
        found: Float = (m - 2) / m * (off**2).sum(axis=0)
        return found


def delete_anchors(estimate: Estimate) -> Deleted | None:
    """Every busy anchor left out in turn; None where fewer than three are busy."""
    problem, weights = estimate.problem, estimate.weights
    n = np.bincount(problem.slots.anchor[problem.slots.slot])
    busy = np.flatnonzero(n >= RARE_SHARE * n.max(initial=1))
    if len(busy) < 3:
        return None
    variance_m2 = weights.lasts * problem.range_std_m**2
    parts = [
        (arrow, *estimate.linear.weighted(problem.slots, each))
        for arrow, each in ((estimate.for_globals, weights.globals), (estimate.for_knots.arrow, weights.knots))
    ]
    knots, values = [], []
    for anchor in busy:
        mine, without = problem.slots.anchor == anchor, []
        for arrow, rows, total in parts:
            left = arrow.copy()
            left.add(rows.rows(mine), -total[mine] / variance_m2)
            without.append(left)
        step, _, _ = posterior_of_globals(problem, without[0], estimate.values)
        knots.append(estimate.knots + without[1].factorised.step_of_knots(step))
        values.append(estimate.values + step)
    return Deleted(busy, np.array(knots), np.array(values))
