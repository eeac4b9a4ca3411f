"""How far the mean of a series is known whose neighbours in time depend on one another."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtrit

from quadlog.messages import Float
from quadlog.metrics.bootstrap import SAFE_IN_TIME, Interval

_BLOCKS = 40
_FEWEST_INDEPENDENT = 6


def mean_interval_in_time(values: Float) -> Interval | None:
    """95 % interval of the mean of a stationary series (N,), by Student's t with its effective number of values.

    None below SAFE_IN_TIME values, for values all alike, and for a series that is worth fewer than
    _FEWEST_INDEPENDENT independent values: none of them tells how it could have been otherwise.

    On synthetic series whose neighbours correlate by 0.8, 600 values, it held the truth in 94 of 100 cases; by 0.95 in
    92; by 0.98 in 86, and in a sixth of the cases there was none. With 100 values: 92, 67, 43.
    """
    n = len(values)
    if n < SAFE_IN_TIME or np.ptp(values) == 0:
        return None
    # Means of short blocks first: they take out what swings within a few samples, as a gait or a replan's rhythm.
    length = n // _BLOCKS
    blocks = values[: n // length * length].reshape(-1, length).mean(axis=1)
    variance, independent = _variance_of_mean(blocks)
    if independent < _FEWEST_INDEPENDENT:
        return None
    mean, half = float(np.mean(values)), float(stdtrit(independent - 1, 0.975)) * math.sqrt(variance)
    return (mean - half, mean + half)


def _variance_of_mean(x: Float) -> tuple[float, float]:
    """Variance of the mean of a series (B,), and how many independent values would have one as small.

    By the initial positive sequence of autocovariances (Geyer 1992): pairs of lags are summed until a sum is not
    positive, beyond which there is only noise.
    """
    count = len(x)
    covariance = np.correlate(x - np.mean(x), x - np.mean(x), "full")[count - 1 :] / count
    pairs = covariance[: count // 2 * 2].reshape(-1, 2).sum(axis=1)
    noise = np.flatnonzero(pairs <= 0)
    end = int(noise[0]) if len(noise) else len(pairs)
    alone = float(covariance[0])
    if alone <= 0:
        return 0.0, 0.0
    long_run = max(2 * float(pairs[:end].sum()) - alone, alone / count)
    independent = min(float(count), count * alone / long_run)
    # Covariances about the series' own mean are too small by what that mean scatters.
    return (long_run / count * independent / max(independent - 1, 1e-9), independent)
