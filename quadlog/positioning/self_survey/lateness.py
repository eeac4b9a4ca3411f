"""Likelihood of range errors: Gaussian in line of sight, late by an exponential delay without it, rarely anything."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erfc, erfcx

from quadlog.messages import Float, Int

WINDOW_S = 2.0
"""The share of late ranges of a link may change from window to window: sight is blocked for a while."""
ODD_SHARE, ODD_SPAN_M = 0.01, 20.0
"""A range may be anything with this probability, which keeps single wrong ranges from counting."""
LATE_PRIOR = (0.3, 0.5)
"""Pseudo-counts of late and of other ranges in each window."""
DELAY_M, DELAY_COUNT = 0.4, 20.0
"""Mean delay of a late range to begin with, and how many ranges that guess is worth."""
LATE_TRUST = 0.1
"""How much a late range counts: delays are not exponential everywhere, and their leading edge would be believed."""
LEAST_STD_M, MOST_STD_M = 0.05, 1.0
LEAST_DELAY_M, MOST_DELAY_M = 0.1, 3.0
LEAST_INFORMATION = 0.02
"""Of a range in line of sight; a mixture's likelihood is not convex everywhere."""


@dataclass(frozen=True, slots=True)
class RangeErrors:
    """Parameters: std_m of a range in line of sight, mean delay_m of a late one, late_share (W,) of each window."""

    std_m: float
    delay_m: float
    late_share: Float


@dataclass(frozen=True, slots=True)
class ErrorScores:
    """Of N residuals: late (N,) the probability of being late, pull (N,) = -d log p/de in 1/m, and curvatures in 1/m^2.

    curvature (N,) never underestimates that of -log p; information (N,) is that curvature itself, kept positive.
    cost: the sum of -log p.
    """

    late: Float
    pull: Float
    curvature: Float
    information: Float
    cost: float


def error_windows(t_s: Float, link: Int) -> Int:
    """(N,) number of each range's window, for its link (N,) and time (N,)."""
    slot = (t_s / WINDOW_S).astype(np.int64)
    _, window = np.unique(link * (int(slot.max(initial=0)) + 1) + slot, return_inverse=True)
    return np.asarray(window, dtype=np.int64)


def score_errors(residual_m: Float, window: Int, errors: RangeErrors) -> ErrorScores:
    """Scores of residuals (N,) under the mixture; a late range is a Gaussian plus an exponential delay."""
    std_m, delay_m = errors.std_m, errors.delay_m
    share = errors.late_share[window] * (1 - ODD_SHARE)
    z = (std_m / delay_m - residual_m / std_m) / np.sqrt(2)
    gauss = np.exp(-0.5 * (residual_m / std_m) ** 2)
    with np.errstate(over="ignore"):
        scaled = erfcx(z)
        decay = np.exp(np.minimum(0.5 * (std_m / delay_m) ** 2 - residual_m / delay_m, 50.0)) * erfc(z)
        delayed = np.where(z < 0, decay, gauss * np.where(z < 0, 0.0, scaled)) / (2 * delay_m)
        ratio = np.sqrt(2 / np.pi) / scaled
    in_sight = (1 - ODD_SHARE - share) * gauss / (std_m * np.sqrt(2 * np.pi))
    delayed = share * delayed
    total = in_sight + delayed + ODD_SHARE / ODD_SPAN_M
    p_sight, p_late = in_sight / total, delayed / total
    pull_sight, pull_late = residual_m / std_m**2, 1 / delay_m - ratio / std_m
    pull = p_sight * pull_sight + LATE_TRUST * p_late * pull_late
    bend_late = ratio * (ratio - np.sqrt(2) * z) / std_m**2
    curvature = p_sight / std_m**2 + LATE_TRUST * p_late * bend_late.clip(0.0)
    mixed = p_sight * pull_sight**2 + LATE_TRUST * p_late * pull_late**2 - pull**2
    least = LEAST_INFORMATION / std_m**2
    information = np.maximum(curvature - mixed, least)
    return ErrorScores(p_late, pull, np.maximum(curvature, least), information, float(-np.log(total).sum()))


def refit_errors(residual_m: Float, window: Int, errors: RangeErrors) -> RangeErrors:
    """One step of expectation-maximisation."""
    scores = score_errors(residual_m, window, errors)
    late = scores.late
    n_windows = len(errors.late_share)
    n, n_late = np.bincount(window, minlength=n_windows), np.bincount(window, late, minlength=n_windows)
    z = (errors.std_m / errors.delay_m - residual_m / errors.std_m) / np.sqrt(2)
    with np.errstate(over="ignore"):
        excess_m = errors.std_m * (np.sqrt(2 / np.pi) / erfcx(z) - np.sqrt(2) * z)
    delay_m = (late @ excess_m + DELAY_COUNT * DELAY_M) / (late.sum() + DELAY_COUNT)
    near = np.abs(residual_m) < 5 * errors.std_m
    sight = (1 - late) * near
    std_m = np.sqrt((sight @ residual_m**2) / max(sight.sum(), 1.0))
    return replace(
        errors,
        std_m=float(np.clip(std_m, LEAST_STD_M, MOST_STD_M)),
        delay_m=float(np.clip(delay_m, LEAST_DELAY_M, MOST_DELAY_M)),
        late_share=(n_late + LATE_PRIOR[0]) / (n + sum(LATE_PRIOR)),
    )
