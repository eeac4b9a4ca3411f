"""Robust weights of ranges: late ranges (blocked paths) are common and persistent, early ones rare."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc, erfcx

from quadlog.messages import Float, Int

WINDOW_S = 0.3
"""Window over which a link's residuals are averaged; a path stays blocked for about one step."""
LATE_MEAN_STD, LATE_MEAN_LEAST = 2.0, 0.4
"""A mean of n residuals is half trusted at the larger of 2 std / sqrt(n) and 0.4 std."""
LATE_STD, EARLY_STD = 3.0, 8.0
"""A single residual is half trusted so many std late or early."""
CLIP_STD = 4.0
HALF_TRUST_STD = 2.0
SHARE_S, SHARE_PRIOR = 2.0, (0.3, 0.5)
"""Over how long the share of late ranges of a link is taken for constant, and pseudo-counts of late and other ones."""
DELAY_M, ODD_SHARE, ODD_SPAN_M = 0.4, 0.01, 20.0
"""Mean delay of a late range; a range may be anything with this probability, over so wide a span."""
BLOCKS_S, FEWEST_BLOCKS = (0.5, 1.0, 2.0, 4.0), 5
"""Over how long residuals of a link are summed to see how much of them lasts."""


def link_windows(t_s: Float, link: Int) -> tuple[Int, Int]:
    """First and end (N,) of windows of WINDOW_S about each of N > 0 ranges, by link, then time: of its own link's."""
    key = t_s + (np.ptp(t_s) + 2 * WINDOW_S) * link
    return np.searchsorted(key, key - WINDOW_S / 2), np.searchsorted(key, key + WINDOW_S / 2, side="right")


def lateness_weights(windows: tuple[Int, Int], residual_m: Float, std_m: float) -> Float:
    """(N,) weights in (0, 1]: low where the mean of a link's residuals over a window is late, or one residual is."""
    x = residual_m / std_m
    total = np.append(0.0, np.cumsum(x.clip(-CLIP_STD, CLIP_STD)))
    first, end = windows
    n = end - first
    mean = (total[end] - total[first]) / n
    late = np.maximum(LATE_MEAN_STD / np.sqrt(n), LATE_MEAN_LEAST)
    by_mean = 1 + (mean / np.where(mean > 0, late, EARLY_STD)) ** 2
    by_one = 1 + (x / np.where(x > 0, LATE_STD, EARLY_STD)) ** 2
    weights: Float = 1 / (by_mean * by_one)
    return weights


def symmetric_weights(residual_m: Float, link: Int, std_m: float) -> Float:
    """(N,) redescending weights about each link's median, alike on both sides: one-sided ones would shift a bias."""
    parts_m = np.split(residual_m, np.cumsum(np.bincount(link))[:-1])  # they are sorted by link
    off_m = residual_m - np.array([_middle(part_m) if len(part_m) else 0.0 for part_m in parts_m])[link]
    spread_m = max(std_m, 1.4826 * _middle(np.abs(off_m)))
    return 1 / (1 + (off_m / (HALF_TRUST_STD * spread_m)) ** 2) ** 2


def _middle(value: Float) -> float:
    """The median of values, of an even number the upper one."""
    return float(np.partition(value, len(value) // 2)[len(value) // 2])


def sight_probabilities(t_s: Float, link: Int, residual_m: Float, std_m: float) -> tuple[Float, float]:
    """(N,) probability that a range was in line of sight, Gaussian, or late by an exponential delay; sum of -log.

    The share of late ranges of each link and SHARE_S is found by expectation-maximisation.
    """
    slot = ((t_s - t_s.min()) / SHARE_S).astype(np.int64)
    _, window = np.unique(link * (int(slot.max()) + 1) + slot, return_inverse=True)
    n = np.bincount(window)
    z = (std_m / DELAY_M - residual_m / std_m) / np.sqrt(2)
    gauss = np.exp(-0.5 * (residual_m / std_m) ** 2)
    falling = np.exp(np.minimum(0.5 * (std_m / DELAY_M) ** 2 - residual_m / DELAY_M, 50.0)) * erfc(z)
    late = np.where(z < 0, falling, gauss * erfcx(z.clip(0.0))) / (2 * DELAY_M)
    gauss = gauss / (std_m * np.sqrt(2 * np.pi))
    share = np.full(len(n), 0.2)
    for _ in range(8):
        sight, delayed = (1 - share[window]) * gauss, share[window] * late
        total = sight + delayed + ODD_SHARE / ODD_SPAN_M
        share = (np.bincount(window, delayed / total, len(n)) + SHARE_PRIOR[0]) / (n + sum(SHARE_PRIOR))
    return sight / total, float(-np.log(total).sum())


def persistence(t_s: Float, link: Int, residual: Float, information: Float, free: float) -> float:
    """By how much the variance of a link's summed residuals exceeds that of white noise, at least 1.

    The largest over blocks of BLOCKS_S counts, at most as many as ranges are in a block. information (N,); free: the
    share of the residuals' degrees of freedom that a fit leaves.
    """
    pull, largest = residual * information, 1.0
    for block_s in BLOCKS_S:
        block = ((t_s - t_s.min()) / block_s).astype(np.int64)
        if block.max() + 1 < FEWEST_BLOCKS:
            break
        cell = block * (int(link.max()) + 1) + link
        excess = float((np.bincount(cell, pull) ** 2).sum() / information.sum()) / free
        largest = max(largest, min(excess, len(cell) / np.count_nonzero(np.bincount(cell))))
    return largest
