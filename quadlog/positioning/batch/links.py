"""What the ranges of a link are worth: bias, residuals, blocked ways, and the track without them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.batch.robust import USUAL_RANGES, link_stds
from quadlog.positioning.batch.solve import Estimate, posterior_of_globals

NLOS_STD, NONE = 3.0, (np.nan,) * 3
"""A range longer than predicted by so many std was late: its straight way was blocked."""
WEAK_FIRST_PATH_DB = 6.0
"""Receiver power this far above that of the first path is the radios' own hint of a blocked way."""

COMMON_STD_M = 0.2
LINK_STDS_M = (0.0, 0.002, 0.02, 0.07)
PRIORS = ("no biases", "one bias of all links", "one of all links, and small ones of each", "a bias of each link")
"""Biases possible a priori, and their std for each link; real sets have 0 to 0.4 m, most of it in common."""
NO_BIAS_M = 1e-3
SCALE_STD, NO_SCALE = 0.05, 1e-5
"""Of the ranges' scale less one, where they have one and where not."""


def range_priors(n_links: int, calibrate: bool, scaled: bool) -> Float:
    """(P, L + 1, L + 1) priors of the links' biases and the ranges' scale; without calibration the first two."""
    from scipy.linalg import block_diag  # slow to import

    stds_m = np.maximum(LINK_STDS_M if calibrate else LINK_STDS_M[:2], NO_BIAS_M)[:, None, None]
    biases = np.where(stds_m > NO_BIAS_M, COMMON_STD_M, NO_BIAS_M) ** 2 + stds_m**2 * np.eye(n_links)
    return np.array([block_diag(each, (SCALE_STD if scaled else NO_SCALE) ** 2) for each in biases])


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
    likely the ranges are under it. scale: of the ranges less one, with its std; zero where they show none.
    """

    bias_m: Float
    std_m: Float
    n: Int
    shares: Float
    scale: float
    scale_std: float

    @property
    def applied_m(self) -> Float:
        """(A,) what to subtract from the ranges: the biases of the links that were heard, zero elsewhere."""
        return np.where(self.n > 0, self.bias_m, 0.0)

    @property
    def reason(self) -> str:
        """What the ranges say about biases as a whole."""
        best = int(np.argmax(self.shares))
        return f"the ranges favour {PRIORS[best]} ({self.shares[best]:.0%})"


def link_quality(
    rows: RangeRows, anchor_ids: Int, bias: AnchorBias | None, range_std_m: Float
) -> dict[str, np.ndarray]:
    """A tag's links to anchors (A,), by column, each (A,); what a link has no ranges for is NaN.

    bias: of these anchors, None when it was not estimated. n: ranges on the track; residual_rms_m, residual_median_m:
    range less prediction, the applied bias taken out; nlos_share: of them late by more than NLOS_STD; bias_m,
    bias_std_m: as estimated; bias_applied; why_not: empty where the bias is applied.
    """
    residual_m = rows.range_m - rows.predicted_m
    of_links_m = [residual_m[(rows.anchor == anchor) & np.isfinite(residual_m)] for anchor in anchor_ids]
    found = [
        (len(m), np.sqrt(np.mean(m**2)), np.median(m), np.mean(m > NLOS_STD * std_m)) if len(m) else (0, *NONE)
        for m, std_m in zip(of_links_m, range_std_m.tolist(), strict=True)
    ]
    n, rms_m, median_m, nlos_share = np.array(found).reshape(-1, 4).T
    unknown = np.full(len(anchor_ids), np.nan)
    applied = np.zeros(len(anchor_ids), dtype=bool) if bias is None else bias.n > 0
    return {
        "n": n.astype(np.int64),
        "residual_rms_m": rms_m,
        "residual_median_m": median_m,
        "bias_m": unknown if bias is None else bias.bias_m,
        "bias_std_m": unknown if bias is None else bias.std_m,
        "bias_applied": applied,
        "why_not": np.where(applied, "", "calibration is off" if bias is None else "no ranges"),
        "range_std_m": range_std_m,
        "nlos_share": nlos_share,
    }


def scatter_in_sight(rows: RangeRows, prior_m: float) -> float:
    """Std of a tag's ranges in sight about its track: the median over its links; prior_m counts as USUAL_RANGES do."""
    residual_m, order = rows.range_m - rows.predicted_m, np.argsort(rows.anchor, kind="stable")
    order = order[np.isfinite(residual_m[order])]
    anchors, link = np.unique(rows.anchor[order], return_inverse=True)
    return float(np.median(link_stds(residual_m[order], link, len(anchors), (prior_m, USUAL_RANGES))))


def weak_first_path_share(ranges: RangeSeries, gap_db: Float | None, tag: int, anchor_ids: Int) -> Float:
    """(A,) share of a tag's ranges whose gap (N,) of receiver to first-path power is wide; NaN where not reported."""
    own_db = np.full(len(ranges), np.nan) if gap_db is None else np.where(ranges.tag == tag, gap_db, np.nan)
    parts_db = (own_db[(ranges.anchor == anchor) & np.isfinite(own_db)] for anchor in anchor_ids)
    return np.array([np.mean(each > WEAK_FIRST_PATH_DB) if len(each) else np.nan for each in parts_db])


RARE_SHARE = 0.05
"""Anchors with fewer ranges than this share of the busiest one's are not left out."""


def delete_anchors(estimate: Estimate) -> tuple[Int, Float, Float]:
    """Knots (G, K, 2, D) and globals (G, M) without each busy anchor (G,), one Newton step on; G = 0 below three."""
    problem, weights = estimate.problem, estimate.weights
    n = np.bincount(problem.slots.anchor[problem.slots.slot])
    busy = np.flatnonzero(n >= RARE_SHARE * n.max(initial=1))
    busy = busy if len(busy) >= 3 else busy[:0]
    of_knots, of_globals = weights.information(problem.slots)
    parts = [
        (arrow, *estimate.linear.weighted(problem.slots, each))
        for arrow, each in ((estimate.for_globals, of_globals), (estimate.for_knots, of_knots))
    ]
    knots, values = np.empty((len(busy), *estimate.knots.shape)), np.empty((len(busy), len(estimate.values)))
    for k, anchor in enumerate(busy):
        mine, without = np.flatnonzero(problem.slots.anchor == anchor), []
        for arrow, rows, total in parts:
            left = arrow.copy()
            left.add(rows.rows(mine), -total[mine])
            without.append(left)
        step, _, _ = posterior_of_globals(problem, without[0], estimate.values)
        knots[k] = estimate.knots + without[1].step_of_knots(step)
        values[k] = estimate.values + step
    return busy, knots, values
