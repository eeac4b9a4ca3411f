"""How far the clocks of two trajectories of one walk are apart, from when the robot was fast and when slow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.positioning import Trajectory

_STEP_S = 0.05
_BASELINE_S = 0.5  # over which a speed is measured: a gait's sway and a fix's noise are no speed
_MOST_STEPS = 1 << 17
_LEAST_OVERLAP = 0.5  # of the shorter trajectory: at its ends anything fits
LEAST_CORRELATION = 0.8
"""Speeds of different walks of a minute came to 0.26 to 0.68 at their best lag."""
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """offset_s: what to add to the estimate's times; correlation: of the speeds then, None if taken from the starts."""

    offset_s: float
    correlation: float | None


def estimate_clock_offset(reference: Trajectory, estimate: Trajectory) -> ClockOffset:
    """The offset at which the speeds of both correlate best; speeds are the same in whatever frame poses are.

    Of two trajectories whose speeds do not tell, the one that lets them start together. Good to some tenths of a
    second where the robot stood, started or slowed down: enough to see what is wrong, not to compare by.
    """
    between_starts_s = int(reference.t_ns[0] - estimate.t_ns[0]) / _NS
    longest_s = max(_duration_s(reference.t_ns), _duration_s(estimate.t_ns))
    step_s = max(_STEP_S, longest_s / _MOST_STEPS)
    speeds = [_speeds(each, step_s) for each in (reference, estimate)]
    if min(map(len, speeds)) < 3:
        return ClockOffset(between_starts_s, None)
    lags, correlation = _correlations(*speeds)
    best = int(np.argmax(correlation))
    if correlation[best] < LEAST_CORRELATION:
        return ClockOffset(between_starts_s, None)
    lag = float(lags[best]) + _vertex(correlation[best - 1 : best + 2])
    return ClockOffset(between_starts_s + lag * step_s, float(correlation[best]))


def _duration_s(t_ns: Int) -> float:
    return int(t_ns[-1] - t_ns[0]) / _NS


def _speeds(trajectory: Trajectory, step_s: float) -> Float:
    """Speed (K,) at even steps from the trajectory's start on."""
    seconds = (trajectory.t_ns - trajectory.t_ns[0]) / _NS
    at_s = np.arange(0.0, seconds[-1], step_s)
    position_m = np.column_stack([np.interp(at_s, seconds, trajectory.position_m[:, axis]) for axis in range(3)])
    ahead = max(1, round(_BASELINE_S / step_s))
    speed: Float = np.linalg.norm(position_m[ahead:] - position_m[:-ahead], axis=1) / (ahead * step_s)
    return speed


def _correlations(a: Float, b: Float) -> tuple[Int, Float]:
    """Pearson's correlation (L,) of a (M,) and b (N,) where they overlap with b moved by lags (L,), -1 where little."""
    lags = np.arange(-(len(b) - 1), len(a))
    count, sum_a, sum_b = (_sliding(x, y) for x, y in ((a * 0 + 1, b * 0 + 1), (a, b * 0 + 1), (a * 0 + 1, b)))
    covariance = count * _sliding(a, b) - sum_a * sum_b
    variance_a = count * _sliding(a**2, b * 0 + 1) - sum_a**2
    variance_b = count * _sliding(a * 0 + 1, b**2) - sum_b**2
    product = variance_a * variance_b
    enough = count >= max(3.0, _LEAST_OVERLAP * min(len(a), len(b)))
    # What the transforms round is no variation.
    told = enough & (np.minimum(variance_a, variance_b) > 1e-9 * count**2 * max(np.max(a**2), np.max(b**2)))
    correlation = np.full(len(lags), -1.0)
    correlation[told] = covariance[told] / np.sqrt(product[told])
    return lags, correlation


def _sliding(a: Float, b: Float) -> Float:
    """Sum over k of a[k + lag] b[k], for each lag from -(N - 1) to M - 1, by Fourier transforms."""
    size = len(a) + len(b) - 1
    return np.fft.irfft(np.fft.rfft(a, size) * np.fft.rfft(b[::-1], size), size)


def _vertex(three: Float) -> float:
    """Where the parabola through three neighbours has its top, from the middle one; 0 at the ends."""
    if len(three) < 3 or np.min(three) <= -1:
        return 0.0
    bend = three[0] - 2 * three[1] + three[2]
    return float(0.5 * (three[0] - three[2]) / bend) if bend < 0 else 0.0
