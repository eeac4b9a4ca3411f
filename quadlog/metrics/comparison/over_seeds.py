"""Values of a metric over random seeds, and which of several settings is best beyond what the seeds explain."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.intervals import corrected_confidence, student_interval

_ROUNDING = 1e-12


class OverSeeds(NamedTuple):
    """Mean of the values that are known, NaN without any; low, high: its 95 % interval, None where seeds give none."""

    mean: float
    low: float | None
    high: float | None


def over_seeds(values: Float) -> OverSeeds:
    """Mean and Student's interval of a metric's values (S,) over seeds, NaN where it has none.

    No interval for fewer than two values, nor for equal ones: then the seed changes nothing, and does not show how
    sure the value is.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return OverSeeds(math.nan, None, None)
    interval = student_interval(known) if _vary(known, known) else None
    return OverSeeds(float(np.mean(known)), *(interval or (None, None)))


def clear_best(values: Float, *, lower: bool) -> int | None:
    """The setting that is best of all beyond doubt, from a metric's values (C, S) of C settings with the same S seeds.

    The setting of the best mean is compared with each rival by the differences between runs of one seed: it is best
    when the interval of each mean difference leaves out 0, with 95 % confidence for all rivals together (Bonferroni,
    which also allows for the choice of the best among several, Hsu 1984).

    Settings without any value are left out. None when there is no rival, when a value is missing otherwise (runs
    that failed are not left out in silence), or when a difference is the same with every seed: it may be chance that
    no seed shows.
    """
    known = np.isfinite(values)
    among = np.flatnonzero(known.any(axis=1))
    if len(among) < 2 or not known[among].all():
        return None
    signed = values[among] if lower else -values[among]
    best = int(np.argmin(signed.mean(axis=1)))
    rivals = np.delete(signed, best, axis=0)
    confidence = corrected_confidence(len(rivals))
    for rival in rivals:
        worse_by = rival - signed[best]
        interval = student_interval(worse_by, confidence) if _vary(worse_by, values[among]) else None
        if interval is None or interval[0] <= 0:
            return None
    return int(among[best])


def _vary(values: Float, among: Float) -> bool:
    """Whether the values differ by more than rounding, beside the size of those that they were computed from."""
    return bool(np.ptp(values) > _ROUNDING * np.abs(among).max())
