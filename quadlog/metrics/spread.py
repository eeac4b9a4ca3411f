"""How one metric differs from run to run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from quadlog.metrics.bootstrap import Interval


@dataclass(frozen=True, slots=True)
class Spread:
    """Over the runs that have the metric: mean, sample standard deviation, quantiles, and the extremes.

    interval: 95 %, of the mean over all runs that could have been; None for one run or runs all alike.
    lowest, highest: which of the values given are the extremes, the first where several are.
    """

    runs: int
    mean: float
    std: float | None
    p50: float
    p95: float
    interval: Interval | None
    lowest: int
    highest: int


def spread(values: Sequence[float], yes_or_no: bool = False) -> Spread | None:
    """Of R runs, None without one. The runs count as independent of one another and about normally distributed.

    yes_or_no: values are 0 or 1, whose interval is Wilson's: it stays inside [0, 1], and wide when all are alike.
    """
    if not values:
        return None
    x = np.asarray(values, dtype=np.float64)
    p50, p95 = (float(each) for each in np.percentile(x, [50, 95]))
    alike = bool(np.ptp(x) == 0)  # whose mean rounding would move
    return Spread(
        runs=len(x),
        mean=float(x[0]) if alike else float(np.mean(x)),
        std=None if len(x) < 2 else 0.0 if alike else float(np.std(x, ddof=1)),
        p50=p50,
        p95=p95,
        interval=_wilson(x) if yes_or_no else _student(x),
        lowest=int(np.argmin(x)),
        highest=int(np.argmax(x)),
    )


def _student(x: np.ndarray) -> Interval | None:
    if len(x) < 2 or np.ptp(x) == 0:
        return None
    mean, half = float(np.mean(x)), float(np.std(x, ddof=1)) / math.sqrt(len(x))
    half *= float(stdtrit(len(x) - 1, 0.975))
    return (mean - half, mean + half)


def _wilson(x: np.ndarray) -> Interval | None:
    if len(x) < 2:
        return None
    n, share, z = len(x), float(np.mean(x)), float(ndtri(0.975))
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    # Both ends hold the share itself; at 0 and 1 rounding would say otherwise.
    return (max(min(middle - half, share), 0.0), min(max(middle + half, share), 1.0))
