"""How far the clocks of two trajectories of one walk are apart, from where their shapes fit on each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.positioning import Trajectory
from quadlog.metrics.rigid_alignment import aligned_square_m2

_STEP_S = 0.05
_MOST_STEPS = 1 << 17
_LEAST_S = 5.0  # of either trajectory: some steps look like any others
_LEAST_PAIRS = 10
_LEAST_OVERLAP = 0.5  # of the most that could be: at its ends anything fits
_LONGEST_GAP_S = 1.0  # that a straight line bridges, unless most gaps are longer
# Shares of how far the robot moved about its mean place:
_PERFECT = 0.01  # whatever fits better than this fits as well
_WORST = 0.25
_APART_S = 1.0
_CLEAR = 2.5
"""How much worse all offsets farther away than _APART_S must fit. Of a walk that UWB positions to 0.1 m, parts of 5 to
40 s are then told to 0.3 s or called ambiguous; two different walks come to 1.3 at most."""
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """offset_s: what to add to the estimate's times; residual_m: how far apart positions are then, rms, once aligned.

    rival_s: another offset, more than a second away, that fits about as well; None when offset_s is clearly the best.
    """

    offset_s: float
    residual_m: float
    rival_s: float | None


def estimate_clock_offset(reference: Trajectory, estimate: Trajectory) -> ClockOffset | None:
    """The offset at which a rigid motion brings the positions of both nearest to each other, whatever frames they have.

    None where one is too short or stands still, and where they fit at no offset. Not by speeds, which are quicker to
    compare: those of a steady walk are alike at many offsets, and those of noisy positions at all.
    """
    durations_s = [_duration_s(each.t_ns) for each in (reference, estimate)]
    if min(durations_s) < _LEAST_S:
        return None
    step_s = max(_STEP_S, max(durations_s) / _MOST_STEPS)
    own = _median_gap_s(reference.t_ns) > _median_gap_s(estimate.t_ns)
    fits = _fits(_sampled(reference, step_s, own), _sampled(estimate, step_s, not own))
    if fits is None:
        return None
    lags, square_m2, spread_m2 = fits
    share = np.sqrt(square_m2 / spread_m2)
    best = int(np.argmin(share))
    far = np.flatnonzero(np.abs(lags - lags[best]) * step_s > _APART_S)
    if share[best] > _WORST or len(far) == 0:
        return None
    between_starts_s = int(reference.t_ns[0] - estimate.t_ns[0]) / _NS
    offset_s = between_starts_s + (float(lags[best]) + _vertex(lags, square_m2, best)) * step_s
    rival = int(far[np.argmin(share[far])])
    clear = share[rival] >= _CLEAR * max(share[best], _PERFECT)
    rival_s = None if clear else between_starts_s + float(lags[rival]) * step_s
    return ClockOffset(offset_s, float(np.sqrt(square_m2[best])), rival_s)


def _duration_s(t_ns: Int) -> float:
    return int(t_ns[-1] - t_ns[0]) / _NS


def _median_gap_s(t_ns: Int) -> float:
    return float(np.median(np.diff(t_ns))) / _NS


def _sampled(trajectory: Trajectory, step_s: float, own: bool) -> tuple[Float, Float]:
    """Positions (K, 3) about their mean at even steps from the start on, and the weight (K,) of each: 1 or 0.

    1 only beside the trajectory's own poses, or anywhere but in gaps: so one of few poses is compared where it has
    them, with the other one between whose poses a straight line does.
    """
    seconds = (trajectory.t_ns - trajectory.t_ns[0]) / _NS
    at_s = np.arange(int(seconds[-1] / step_s) + 1) * step_s
    position_m = np.column_stack([np.interp(at_s, seconds, axis_m) for axis_m in trajectory.position_m.T])
    if own:
        weight = np.zeros(len(at_s))
        weight[np.minimum(np.round(seconds / step_s).astype(np.int64), len(at_s) - 1)] = 1
    else:
        after = np.clip(np.searchsorted(seconds, at_s), 1, len(seconds) - 1)
        longest_s = max(_LONGEST_GAP_S, 3 * _median_gap_s(trajectory.t_ns))
        weight = (seconds[after] - seconds[after - 1] <= longest_s).astype(np.float64)
    return position_m - position_m.mean(axis=0), weight


@np.errstate(over="ignore", invalid="ignore")  # of positions beyond all measure, which then fit nowhere
def _fits(a: tuple[Float, Float], b: tuple[Float, Float]) -> tuple[Int, Float, Float] | None:
    """For b moved by lags (L,): the mean squared distance (L,) that alignment leaves, and the smaller variance (L,).

    Only lags with enough overlap and motion; None if there are none.
    """
    lags = np.arange(-(len(b[0]) - 1), len(a[0]))
    sums = _sliding_sums(a, b)
    count = sums[0, 0]
    enough = count >= max(_LEAST_PAIRS - 0.5, _LEAST_OVERLAP * count.max())
    lags, means = lags[enough], sums[:, :, enough] / count[enough]
    if len(lags) == 0 or not np.isfinite(means).all():
        return None
    centre_a, centre_b = means[1:4, 0], means[0, 1:4]
    spread_a, spread_b = means[4, 0] - (centre_a**2).sum(axis=0), means[0, 4] - (centre_b**2).sum(axis=0)
    covariance = np.moveaxis(means[1:4, 1:4] - centre_a[:, None] * centre_b[None, :], 2, 0)
    smaller = np.minimum(spread_a, spread_b)
    # What the transforms round is no motion.
    moved = smaller > 1e-9 * max(spread_a.max(), spread_b.max())
    if not moved.any():
        return None
    square = aligned_square_m2(spread_a[moved], spread_b[moved], covariance[moved])
    return lags[moved], square, smaller[moved]


def _sliding_sums(a: tuple[Float, Float], b: tuple[Float, Float]) -> Float:
    """Sums (5, 5, L) over the overlap of products of 1, x, y, z and the squared length of a with those of b, weighted.

    For each lag from -(N - 1) to M - 1, by Fourier transforms.
    """
    size = len(a[0]) + len(b[0]) - 1
    terms = [
        np.vstack([np.ones(len(weight)), position_m.T, (position_m**2).sum(axis=1)]) * weight
        for position_m, weight in (a, b)
    ]
    of_a, of_b = np.fft.rfft(terms[0], size), np.fft.rfft(terms[1][:, ::-1], size)
    sums: Float = np.fft.irfft(of_a[:, None] * of_b[None, :], size)
    return sums


def _vertex(lags: Int, square: Float, best: int) -> float:
    """Where the parabola through the best lag and its neighbours has its top, from it; 0 where one is missing."""
    if not 0 < best < len(lags) - 1 or lags[best + 1] - lags[best - 1] != 2:
        return 0.0
    before, middle, after = square[best - 1 : best + 2]
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -1, 1)) if bend > 0 else 0.0
