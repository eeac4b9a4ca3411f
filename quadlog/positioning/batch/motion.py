"""Knots in segments, cubic Hermite splines between them, the means of white-acceleration processes [Barfoot]."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from quadlog.messages import Float, Int

ACCELERATION_LASTS_S = 0.1
"""Correlation time of a walker's acceleration, about half a step."""
TURN_STD_RADPS, TURN_LASTS_S = 0.5, 2.0
HEIGHT_LASTS_S, HEIGHT_SMOOTH_S = 20.0, 0.5
"""A height is forgotten within the first, and smooth over the second."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """K >= 2 knots at rising t_s (K,). connected (K - 1,) bool: whether a knot and the next belong to one segment."""

    t_s: Float
    connected: np.ndarray

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


@dataclass(frozen=True, slots=True)
class Sampling:
    """interval (N,); value, rate (4, N): weights of q, q' of the knot before, q, q' of the knot after."""

    interval: Int
    value: Float
    rate: Float

    def of(self, knots: Float) -> tuple[Float, Float]:
        """Coordinates and rates (N, D) of knots (K, 2, D)."""
        flat = np.ascontiguousarray(knots.transpose(1, 2, 0))
        around = np.concatenate([flat.take(self.interval, axis=2), flat.take(self.interval + 1, axis=2)])
        return np.einsum("jn,jdn->dn", self.value, around).T, np.einsum("jn,jdn->dn", self.rate, around).T


def make_timeline(t_s: Float, step_s: float, longest_gap_s: float, cuts_s: Float) -> Timeline:
    """Knots step_s apart over N > 0 instants in order, and at the last; a new segment after longer gaps and each cut.

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


@dataclass(frozen=True, slots=True)
class Motion:
    """q'' = -stiffness q - damping q' + w, with white noise w of spectral density `density`.

    start_std, start_rate_std: of the coordinate and its rate where a segment starts.
    """

    density: float
    damping: float = 0.0
    stiffness: float = 0.0
    start_std: float = 100.0
    start_rate_std: float = 1.0


def walking(acceleration_std_mps2: float) -> Motion:
    """Of a horizontal coordinate of a walker."""
    return Motion(acceleration_std_mps2**2 * ACCELERATION_LASTS_S)


def turning() -> Motion:
    """Of yaw, whose rate is a first-order Gauss-Markov process."""
    density = 2 * TURN_STD_RADPS**2 / TURN_LASTS_S
    return Motion(density, 1 / TURN_LASTS_S, start_std=2.0, start_rate_std=TURN_STD_RADPS)


def lifting(std_m: float) -> Motion:
    """Of a height about its known mean."""
    damping, stiffness = 1 / HEIGHT_LASTS_S + 1 / HEIGHT_SMOOTH_S, 1 / (HEIGHT_LASTS_S * HEIGHT_SMOOTH_S)
    rate_std = std_m * float(np.sqrt(stiffness))
    return Motion(2 * damping * rate_std**2, damping, stiffness, std_m, rate_std)


@lru_cache(maxsize=1000)
def _step_information(motions: tuple[Motion, ...], dt_s: float) -> Float:
    """(4D, 4D) information about two knots (q, q', q, q') dt_s apart from D motions between them [Van Loan]."""
    from scipy.linalg import expm  # slow to import

    size = len(motions)
    found = np.zeros((4, size, 4, size))
    for axis, motion in enumerate(motions):
        drift, noise = np.array([[0.0, 1.0], [-motion.stiffness, -motion.damping]]), np.diag([0.0, motion.density])
        both = expm(np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]]) * dt_s)
        step = both[2:, 2:].T
        change = np.hstack([-step, np.eye(2)])
        found[:, axis, :, axis] = change.T @ np.linalg.solve(step @ both[:2, 2:], change)
    return found.reshape(4 * size, 4 * size)


def motion_information(motions: tuple[Motion, ...], timeline: Timeline) -> Float:
    """(K - 1, 4D, 4D) information about neighbouring knots; the first of a segment is known to start_std about zero."""
    size, lengths_s = len(motions), np.diff(timeline.t_s).round(7).tolist()
    information = np.array([_step_information(motions, each_s) for each_s in lengths_s])
    information *= timeline.connected[:, None, None]
    start = np.array([m.start_std for m in motions] + [m.start_rate_std for m in motions])
    at = np.arange(2 * size)
    for first in timeline.firsts.tolist():
        row = min(first, len(timeline.connected) - 1)
        shift = 2 * size * (first - row)
        information[row, at + shift, at + shift] += start**-2.0
    return information


@dataclass(frozen=True, slots=True)
class Track:
    """The way of a tag, or of a body, at T instants.

    t_ns: (T,) strictly increasing; position_m, velocity_mps: (T, 2) in map.
    covariance_m2, velocity_covariance_m2ps2: (T, 2, 2) of each of them.
    z_m, z_std_m: (T,) height in map; where it was given instead of tracked, that, and a std of zero.
    position_excess: (T,) or (1,), by how much covariance_m2 was raised above what the estimator works with.
    """

    t_ns: Int
    position_m: Float
    velocity_mps: Float
    covariance_m2: Float
    velocity_covariance_m2ps2: Float
    z_m: Float
    z_std_m: Float
    position_excess: Float = field(default_factory=lambda: np.ones(1))

    def __len__(self) -> int:
        return len(self.t_ns)
