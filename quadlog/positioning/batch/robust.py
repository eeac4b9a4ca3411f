"""What ranges are worth: noise, how long errors last, robust weights. Late ones are common and last; early are rare."""

from __future__ import annotations

from functools import cache

import numpy as np

from quadlog.messages import Float, Int

WINDOW_S = 0.3
"""Window over which a link's residuals are averaged; a path stays blocked for about one step."""
LATE_MEAN_STD, LATE_MEAN_LEAST = 2.0, 0.4
"""A mean of n residuals is half trusted at the larger of 2 std / sqrt(n) and 0.4 std."""
LATE_STD, EARLY_STD = 3.0, 8.0
"""A single residual is half trusted so many std late or early."""
CLIP_STD = 4.0
HALF_TRUST_STD = 2.5
SHARE_S, SHARE_PRIOR = 2.0, (0.3, 0.5)
"""Over how long the share of late ranges of a link is taken for constant, and pseudo-counts of late and other ones."""
DELAYS_STD, ODD_SHARE, ODD_SPAN_M = (2.0, 5.0, 12.5), 0.01, 20.0
"""Mean delays of late ranges, in std of ranges in sight; and how likely a range is anything, over so wide a span."""
LATE_BY_STD, BLOCKED_SHARE, MOSTLY_SHARE, WHITE_S, WHITE_RANGES = 3.0, 0.03, 0.16, 0.25, 3.0
"""Paths are blocked where, of ranges off by more std, so many more are late than early. Errors of the ranges in sight
that last no longer are white; others are reflections, unless so many more ranges are late. Chosen on walks of seeds
501 and 502 and on real logs, which came to 0.18 s or less, and to 0.46 s or more with a share up to 0.10. Not so
delays that are constant for each anchor: they came to 1.3 s with 0.07, and are then taken for reflections.
"""
LEAST_SURE = 0.1
"""Of what ranges in sight show where it is unknown which they are, at least so much is left."""
BLOCKS_S, FEWEST_BLOCKS = (0.5, 1.0, 2.0, 4.0), 5
"""Over how long residuals of a link are summed to see how much of them lasts."""
USUAL_STD_M, USUAL_RANGES, STD_BOUNDS_M = 0.1, 100, (0.02, 0.3)
"""Of a range in sight [Following, Fig. 9], as many ranges as that counts for, and what those of a link may say,
which is no more unless all links together do."""
FEWEST_RANGES, MODE_SHARE, MODE_RANGES, EARLY_SHARE = 6, 0.25, 20, 0.1
"""Of a link that shows a std; and so much of it, or so many if that is more, lie closest together about the mode. A
half about the mode has always more of it than the last."""
ALIKE = 1.5
"""Links whose stds differ by less from the usual one have that: link by link tracks err by up to 10 % more."""


def link_stds(residual_m: Float, link: Int, n_links: int, prior: tuple[float, int], *, by_zero: bool = True) -> Float:
    """(L,) std of the ranges in sight of each link, from residuals (N,) by link.

    From the early half about the mode, or about zero where that is narrower: blocked paths lengthen the late one, and
    the mode may be theirs. prior: a std, and how many ranges it is.
    """
    count, early, own_m = np.bincount(link, minlength=n_links), list[Float](), np.full(n_links, np.nan)
    for k, part_m in enumerate(np.split(residual_m, np.cumsum(count)[:-1])):
        if len(part_m) >= FEWEST_RANGES:
            part_m, n = np.sort(part_m), len(part_m)
            some = min(max(int(MODE_SHARE * n), MODE_RANGES), n // 2)
            first = int(np.argmin(part_m[some:] - part_m[:-some]))
            mode_m = float(np.median(part_m[first : first + some + 1]))
            halves = [at_m - part_m[part_m <= at_m] for at_m in ((mode_m, 0.0) if by_zero else (mode_m,))]
            early.append(min((each for each in halves if len(each) > EARLY_SHARE * n), key=np.median))
            own_m[k] = np.median(early[-1])
    prior_m, n_prior = prior
    if not early:
        return np.full(n_links, prior_m)
    usual_m, n = max(1.4826 * float(np.median(np.concatenate(early))), 1e-6), len(residual_m)
    apart = np.log(np.nan_to_num(1.4826 * own_m / usual_m, nan=1.0).clip(1e-3))
    apart = np.sign(apart) * (np.abs(apart) - np.log(ALIKE)).clip(0.0) * count / (count + n_prior)
    usual_m = np.sqrt((n * usual_m**2 + n_prior * prior_m**2) / (n + n_prior))
    return (usual_m * np.exp(apart)).clip(STD_BOUNDS_M[0], max(STD_BOUNDS_M[1], usual_m))


def link_windows(t_s: Float, link: Int) -> tuple[Int, Int]:
    """First and end (N,) of windows of WINDOW_S about each of N > 0 ranges, by link, then time: of its own link's."""
    key = t_s + (np.ptp(t_s) + 2 * WINDOW_S) * link
    return np.searchsorted(key, key - WINDOW_S / 2), np.searchsorted(key, key + WINDOW_S / 2, side="right")


def lateness_weights(windows: tuple[Int, Int], residual_m: Float, std_m: Float) -> Float:
    """(N,) weights in (0, 1]: low where the mean of a link's residuals over a window is late, or one residual is."""
    x = residual_m / std_m
    total = np.append(0.0, np.cumsum(x.clip(-CLIP_STD, CLIP_STD)))
    first, end = windows
    n = end - first
    mean = (total[end] - total[first]) / n
    late = np.maximum(LATE_MEAN_STD / np.sqrt(n), LATE_MEAN_LEAST)
    by_mean = 1 + (mean / np.where(mean > 0, late, EARLY_STD)) ** 2
    by_one = 1 + (x / np.where(x > 0, LATE_STD, EARLY_STD)) ** 2
    return 1 / (by_mean * by_one)


def symmetric_weights(residual_m: Float, link: Int, std_m: Float) -> Float:
    """(N,) redescending weights about each link's median, alike on both sides: one-sided ones would shift a bias."""
    parts_m = np.split(residual_m, np.cumsum(np.bincount(link))[:-1])  # they are sorted by link
    medians_m = [np.partition(each, len(each) // 2)[len(each) // 2] if len(each) else 0.0 for each in parts_m]
    off_m = residual_m - np.array(medians_m)[link]
    return 1 / (1 + (off_m / (HALF_TRUST_STD * std_m)) ** 2) ** 2


@cache
def _late_density() -> tuple[Float, Float]:
    """Residuals in std, and the logarithm of the density of late ones: normal noise and an exponential delay."""
    from scipy.special import erfc, erfcx  # slow to import

    x = np.arange(-10.0, 200.0, 0.05)
    total = np.zeros(len(x))
    for mean in DELAYS_STD:
        z = (1 / mean - x) / np.sqrt(2)
        falling = np.exp(np.minimum(0.5 / mean**2 - x / mean, 50.0)) * erfc(z)
        total += np.where(z < 0, falling, np.exp(-0.5 * x**2) * erfcx(z.clip(0.0))) / (2 * mean * len(DELAYS_STD))
    return x, np.log(total)


def sight_probabilities(t_s: Float, link: Int, residual_m: Float, std_m: Float) -> tuple[Float, Float, Float]:
    """(N,) probabilities that a range was in line of sight, and that it was anything; -log likelihoods.

    In sight it is Gaussian, else late by an exponential delay of several lengths, or anything. The share of late ranges
    of each link and SHARE_S is found by expectation-maximisation.
    """
    slot = ((t_s - t_s.min()) / SHARE_S).astype(np.int64)
    _, window = np.unique(link * (int(slot.max()) + 1) + slot, return_inverse=True)
    n, x = np.bincount(window), residual_m / std_m
    gauss, odd = np.exp(-0.5 * x**2 - 0.5 * np.log(2 * np.pi)), ODD_SHARE / ODD_SPAN_M * std_m
    late = np.exp(np.interp(x, *_late_density()))
    share = np.full(len(n), 0.2)
    for _ in range(8):
        sight, delayed = (1 - share[window]) * gauss, share[window] * late
        total = sight + delayed + odd
        share = (np.bincount(window, delayed / total, len(n)) + SHARE_PRIOR[0]) / (n + sum(SHARE_PRIOR))
    return sight / total, odd / total, -np.log(total / std_m)


def sure_share(link: Int, x: Float, sight: Float, odd: Float) -> Float:
    """(N,) of what ranges in sight of a link would show, how much is left as it is unknown which these are [Louis].

    x (N,): residuals in std. Missing is the variance, over what a range may be, of the log likelihood's slope.
    """
    at, density = _late_density()
    late, slope = 1 - sight - odd, np.interp(x, at, np.gradient(density, at))
    missing = sight * x**2 + late * slope**2 - (late * slope - sight * x) ** 2
    left = 1 - np.bincount(link, missing) / np.maximum(np.bincount(link, sight), 1e-12)
    return left.clip(LEAST_SURE, 1.0)[link]


def persistence(t_s: Float, link: Int, pull: Float, free: float) -> Float:
    """(N,) how many ranges of a link share an error, from how much sums of their pull (N,) over a block exceed noise.

    The blocks of BLOCKS_S with the largest count; where a block has more than usual, the body stands, and more share
    it. pull: weighted residuals, by link, then time; free: the share of errors that last which a fit leaves in them.
    """
    largest, found = 1.0, np.ones(len(t_s))
    for block_s in BLOCKS_S:
        block = ((t_s - t_s.min()) / block_s).astype(np.int64)
        if block.max() + 1 < FEWEST_BLOCKS:
            break
        begin = np.flatnonzero(np.diff(block + link * (int(block.max()) + 1), prepend=-1))
        n = np.diff(begin, append=len(link))
        excess, usual = np.add.reduceat(pull, begin) ** 2 / (pull**2).mean() - n, n <= 2 * np.median(n)
        shared = excess[usual].sum() / max(float((n * (n - 1))[usual].sum()), 1.0) / free
        lasts = 1 + min(max(shared, 0.0), 1.0) * (n - 1)
        if np.median(lasts) > largest:
            largest, found = float(np.median(lasts)), np.repeat(lasts, n)
    return found
