"""Which planner is best, by cells or by time: with intervals that allow for its having been chosen from several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.metrics.intervals import (
    FEWEST_IN_TIME,
    FEWEST_VALUES,
    Interval,
    corrected_confidence,
    fewest_values,
    median_interval,
    median_interval_in_time,
    pooled_median_interval,
    ratio_interval_in_time,
)


@dataclass(frozen=True, slots=True)
class Spending:
    """What planners spent on the R replans that all of them solved: cells or microseconds, (R,) or K times (R, K) each.

    episode (R,): sorted. seed: every interval draws the same, whatever else is compared.
    """

    of: Mapping[str, NDArray[np.generic]]
    episode: NDArray[np.int64]
    seed: int

    def once(self, name: str) -> Float:
        """(R,) of a planner, the median of its repeats."""
        spent: Float = np.asarray(self.of[name], dtype=np.float64)
        return spent if spent.ndim == 1 else np.median(spent, axis=1)

    def ratios(self, over: str, under: str) -> Float:
        """What one planner spent over what another did: (E,) by episode, by repeat where there is a single replan.

        NaN where the other spent nothing.
        """
        if self._is_single:
            parts, wholes = (np.asarray(self.of[name], dtype=np.float64)[0] for name in (over, under))
        else:
            _, episode = np.unique(self.episode, return_inverse=True)
            # As weights they are float64, which holds every sum of cells exactly up to 2^53.
            parts, wholes = (np.bincount(episode, self.once(name)) for name in (over, under))
        ratios: Float = np.divide(parts, wholes, out=np.full(len(wholes), np.nan), where=wholes > 0)
        return ratios

    def ratio(self, over: str, under: str) -> float | None:
        """Median of `ratios`; None where there is none."""
        ratios = self.ratios(over, under)
        ratios = ratios[np.isfinite(ratios)]
        return float(np.median(ratios)) if len(ratios) else None

    def ratio_interval(self, over: str, under: str, confidence: float = 0.95) -> Interval | None:
        """Of `ratio`; of a single episode by blocks of its replans. None where there are too few."""
        ratios, rng = self.ratios(over, under), np.random.default_rng(self.seed)
        if len(ratios) == 1 and not self._is_single:
            return ratio_interval_in_time(self.once(over), self.once(under), rng, confidence)
        ratios = ratios[np.isfinite(ratios)]
        return median_interval(ratios, rng, confidence) if len(ratios) >= fewest_values(confidence) else None

    def median_interval(self, name: str) -> Interval | None:
        """95 % interval of the median over all replans; None where there are too few."""
        spent, rng = self.once(name), np.random.default_rng(self.seed)
        if self._is_single:
            repeats = np.atleast_1d(np.asarray(self.of[name], dtype=np.float64)[0])
            return median_interval(repeats, rng) if len(repeats) >= FEWEST_VALUES else None
        if len(np.unique(self.episode)) == 1:
            return median_interval_in_time(spent, rng) if len(spent) >= FEWEST_IN_TIME else None
        return pooled_median_interval(spent, self.episode, rng)

    @property
    def _is_single(self) -> bool:
        return len(self.episode) == 1 and next(iter(self.of.values())).ndim == 2


@dataclass(frozen=True, slots=True)
class Lead:
    """A planner that spent least of several.

    gain: what the baseline spent over what it did; low, high: its interval, None where too few. That holds the truth
    in 95 of 100 cases although the best of `choices` was chosen.
    unbeaten: the others that it is not shown to beat: their paired interval holds 1, or there is none.
    """

    planner: str
    choices: int
    gain: float
    low: float | None
    high: float | None
    unbeaten: tuple[str, ...]


def lead_of(spending: Spending, best: str, others: Sequence[str], baseline: str) -> Lead | None:
    """What the lead of the best over the others rests on; None where it has no ratio to the baseline."""
    gain = spending.ratio(baseline, best)
    if gain is None:
        return None
    low, high = spending.ratio_interval(baseline, best, corrected_confidence(len(others) + 1)) or (None, None)
    confidence = corrected_confidence(len(others))
    intervals = {name: spending.ratio_interval(name, best, confidence) for name in others}
    unbeaten = tuple(name for name, interval in intervals.items() if interval is None or interval[0] <= 1)
    return Lead(best, len(others) + 1, gain, low, high, unbeaten)
