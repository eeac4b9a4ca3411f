"""Knots in segments, and the cubic Hermite spline between them: the mean of a white-acceleration process [Barfoot]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int


@dataclass(frozen=True, slots=True)
class Timeline:
    """K >= 2 knots at rising t_s (K,). connected (K - 1,) bool: whether a knot and the next belong to one segment."""

    t_s: Float
    connected: np.ndarray

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def firsts(self) -> Int:
        """The first knot of each segment."""
        return np.append(0, np.flatnonzero(~self.connected) + 1)

    def sample(self, t_s: Float) -> Sampling:
        """Weights of the knots at instants (N,); outside of the segments the nearest knot counts."""
        interval = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, len(self.t_s) - 2)
        dt_s = self.t_s[interval + 1] - self.t_s[interval]
        s = ((t_s - self.t_s[interval]) / dt_s).clip(0.0, 1.0)
        s = np.where(self.connected[interval], s, np.round(s))
        bend = 6 * s * (1 - s) / dt_s * self.connected[interval]
        value = [(1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2 * dt_s, s**2 * (3 - 2 * s), -(s**2) * (1 - s) * dt_s]
        return Sampling(interval, np.array(value), np.array([-bend, (1 - s) * (1 - 3 * s), bend, s * (3 * s - 2)]))

    def between(self, t_s: Float, values: Float) -> Float:
        """Values (K, ...) of the knots at instants (N,), linear between knots and held beyond the ends."""
        after = np.searchsorted(self.t_s, t_s).clip(1, len(self.t_s) - 1)
        share = ((t_s - self.t_s[after - 1]) / (self.t_s[after] - self.t_s[after - 1])).clip(0.0, 1.0)
        share = np.where(self.connected[after - 1], share, np.round(share))
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        found: Float = (1 - share) * values[after - 1] + share * values[after]
        return found


@dataclass(frozen=True, slots=True)
class Sampling:
    """interval (N,); value, rate (4, N): weights of q, q' of the knot before, q, q' of the knot after."""

    interval: Int
    value: Float
    rate: Float

    def of(self, knots: Float) -> tuple[Float, Float]:
        """Coordinates and rates (N, D) of knots (K, 2, D)."""
        around = np.concatenate([knots[self.interval], knots[self.interval + 1]], axis=1)
        return np.einsum("jn,njd->nd", self.value, around), np.einsum("jn,njd->nd", self.rate, around)


def make_timeline(t_s: Float, step_s: float, longest_gap_s: float, cuts_s: Float) -> Timeline:
    """Knots step_s apart over N > 0 instants in order, and one at the last; a new segment after each longer gap and at
    each cut.

    The last two knots of a segment are a quarter of a step to one and a quarter apart.
    """
    apart = np.diff(t_s) > longest_gap_s
    if len(apart):
        apart[np.searchsorted(t_s, cuts_s).clip(1, len(t_s) - 1) - 1] = True
    begins = np.append(0, np.flatnonzero(apart) + 1)
    ends = np.append(begins[1:], len(t_s)) - 1
    knots, connected = [], []
    for first_s, last_s in zip(t_s[begins].tolist(), t_s[ends].tolist(), strict=True):
        last_s = max(last_s, first_s + 1e-3)
        steps = max(int(np.ceil((last_s - first_s) / step_s - 0.25)), 1)
        knots.append(np.append(first_s + step_s * np.arange(steps), last_s))
        connected += [True] * steps + [False]
    return Timeline(np.concatenate(knots), np.array(connected[:-1]))
