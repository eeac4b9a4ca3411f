"""95 % intervals: of independent values, of shares, of a median, of a mean in time; wider ones for several at once."""

from __future__ import annotations

import math

import numpy as np

from quadlog.messages import Float

SHORTEST_S = 30.0
"""No interval of a shorter log: a walk turns a corner every 6 to 20 s, and what comes then is not in it."""
FEWEST_IN_TIME = 20
"""With fewer values a series says nothing of how its mean could have been otherwise."""
COVERAGE = (
    "On walks of 30 to 300 s, 95 % intervals hold the truth in 0.93 to 0.98 (means), 0.97 to 0.99 (deviations) and "
    "0.98 to 0.99 (rms) of simulations whose errors are correlated over 0.1 to 2 s. On pieces of three simulated "
    "replays, not those on which constants were chosen, they hold the whole replay's value in 0.93 (30 s) and 0.90 "
    "(60 s), and are 1.5 and 1.7 times as wide as the pieces scatter (median of 13 metrics; of cells and costs of "
    "paths 2 to 4 times)."
)
"""What tests/quadlog/metrics/test_summary.py measures; the page and docs/metrics.md state it."""

Interval = tuple[float, float]
Z_95 = 1.959963984540054
"""Two-sided 95 % quantile of a normal."""


def student_interval(values: Float, confidence: float = 0.95) -> Interval | None:
    """Interval of the mean of values (N,), independent and about normally distributed; None below two."""
    if len(values) < 2:
        return None
    mean, half = float(np.mean(values)), float(np.std(values, ddof=1)) / math.sqrt(len(values))
    half *= _student_quantile(len(values) - 1, confidence)
    return mean - half, mean + half


def _student_quantile(freedom: float, confidence: float) -> float:
    from scipy.special import stdtrit  # a quarter of a second to import

    return float(stdtrit(freedom, (1 + confidence) / 2))


def wilson_interval(count: int, total: int) -> Interval:
    """Interval of the share count/total after Wilson, which stays inside [0, 1] and is wide at its ends."""
    share, z2 = count / total, Z_95**2
    middle = (share + z2 / (2 * total)) / (1 + z2 / total)
    half = Z_95 / (1 + z2 / total) * math.sqrt(share * (1 - share) / total + z2 / (4 * total**2))
    # Both ends hold the share itself; at 0 and 1 rounding would say otherwise.
    return max(min(middle - half, share), 0.0), min(max(middle + half, share), 1.0)


def corrected_confidence(comparisons: int) -> float:
    """The confidence of each of several intervals that together hold all truths in 95 of 100 cases (Bonferroni).

    For the best of k + 1, compared with each of the k others, it allows for the choice as well: to choose a wrong one,
    the interval of its comparison with the right one must fail (Hsu 1984).
    """
    return 1 - 0.05 / max(comparisons, 1)


def fewest_values(confidence: float) -> int:
    """How many independent values it takes until their range holds the true median with this confidence."""
    return 1 + math.ceil(-math.log2(1 - confidence))


def median_interval(values: Float, confidence: float = 0.95) -> Interval | None:
    """Interval of the median of independent values (N,), whatever their distribution; None below fewest_values.

    Between the k-th smallest and the k-th largest, the most inner ones that hold it as often as asked.
    """
    from scipy.special import bdtr

    n, ordered = len(values), np.sort(values)
    k = np.count_nonzero(bdtr(np.arange(n // 2), n, 0.5) <= (1 - confidence) / 2 * (1 + 1e-12))
    return (float(ordered[k - 1]), float(ordered[n - k])) if k else None


_FEWEST_WAVES, _MOST_WAVES, _OF_WAVE = 3, 20, 6
_WIDER = 9.0
"""Chosen on three simulated replays of 240 s, so that 0.91 of pieces of 30 s and 0.93 of 60 s are held."""


def mean_interval_in_time(values: Float, confidence: float = 0.95) -> Interval | None:
    """Interval of the mean of a stationary series (N,) whose neighbours are alike; COVERAGE says how well it holds.

    The variance of the mean is what the slowest waves of the series have: few, so that faster swings than those between
    them do not count, and more where the series is worth more independent values; Student's t has as many degrees of
    freedom. It is widened where these are few. None of fewer than FEWEST_IN_TIME values or of equal ones.
    """
    if len(values) < FEWEST_IN_TIME or np.ptp(values) == 0:
        return None
    independent = independent_values(values)
    waves = int(np.clip(independent // _OF_WAVE, _FEWEST_WAVES, _MOST_WAVES))
    half = math.sqrt(_variance_of_mean(values, waves)) * (1 + _WIDER / independent)
    half *= _student_quantile(waves, confidence)
    mean = float(np.mean(values))
    return (mean - half, mean + half)


def independent_values(values: Float) -> float:
    """How many independent values would give the mean of a series (N,), not all alike, as well."""
    return float(np.clip(np.var(values) / max(_variance_of_mean(values, 4), 1e-300), 1, len(values)))


def _variance_of_mean(values: Float, waves: int) -> float:
    """By the slowest waves of a series (N,), each of half a period more (Müller 2007)."""
    at = np.pi * (np.arange(len(values)) + 0.5) / len(values)
    sizes = [np.mean((values - np.mean(values)) * np.cos(wave * at)) for wave in range(1, waves + 1)]
    return 2 * float(np.mean(np.square(sizes)))


def positive_interval(value: float, interval: Interval, upwards: float = 1.5) -> Interval:
    """An interval about a value above 0 that stays above 0, and reaches farther up, by a power."""
    half = (interval[1] - interval[0]) / 2 / value
    return value * math.exp(-half), value * (1 + half) ** upwards


def ratio_interval_in_time(parts: Float, wholes: Float, confidence: float = 0.95) -> Interval | None:
    """Interval of sum(parts) / sum(wholes) of one series, (N,) each in time order; None where there is no ratio."""
    if not parts.sum() > 0 or not wholes.sum() > 0:
        return None
    ratio = float(parts.sum() / wholes.sum())
    series = ratio + (parts - ratio * wholes) / wholes.mean()
    found = mean_interval_in_time(series, confidence)
    return None if found is None else positive_interval(ratio, found)
