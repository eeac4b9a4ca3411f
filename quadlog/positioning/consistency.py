"""How much larger the errors of a track are than white range noise would make them, from the residuals alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from quadlog.messages import Float, Int

NOISE_SHARE = 0.75
"""Of a position's variance what range noise brings, the rest being motion that the filter has not followed. Exact in
the steady state under white acceleration, filtered and smoothed alike."""
PRIOR_DOF = 10.0
"""So many degrees of freedom stand for white noise before the log has shown any."""


@dataclass(frozen=True, slots=True)
class Tally:
    """Sums over the blocks of a log: squared scores of the links, degrees of freedom, weights and slopes."""

    square: float = 0.0
    dof: float = 0.0
    weight: float = 0.0
    slope: float = 0.0
    links: float = 0.0


def excess_variance(
    tally: Tally,
    first_row: Int,
    anchor: Int,
    residual_m: Float,
    weight: Float,
    slope: Float,
    unit: Float,
    covariance_m2: Float,
    range_std_m: float,
) -> tuple[Float, Tally]:
    """(T,) factor on the variance that ranges bring, from what is known before each instant; and the tally after all.

    anchor, residual_m, weight, slope: (N,) of each range, slope being the
    derivative of weight x residual; unit (N, D) its direction; covariance_m2
    (T, D, D) of the place. A block lasts until its ranges hold as much
    information as they bring to one pose. Within it, each link's residuals are
    summed as they are in the estimate (so errors that persist add up, white
    ones do not), the place is fitted once more (D degrees of freedom per block:
    what the track absorbed cannot be seen, and the other links tell how large
    it is), and the rest is compared with white noise. For robust weights this
    is the sandwich H^-1 S H^-1, with S the scores' and H the slopes' sum.
    """
    sums = _tally_blocks(
        first_row, anchor, residual_m, weight, slope, unit, covariance_m2, range_std_m, int(anchor.max(initial=-1)) + 1
    )
    sums = sums + np.array([tally.square, tally.dof, tally.weight, tally.slope, tally.links])
    before = sums[:-1].T
    return _excess(before, range_std_m), Tally(*(float(each) for each in sums[-1]))


def total_excess(tally: Tally, range_std_m: float) -> float:
    """The factor that a whole log shows."""
    sums = np.array([[tally.square], [tally.dof], [tally.weight], [tally.slope], [tally.links]])
    return float(_excess(sums, range_std_m)[0])


def _excess(sums: Float, range_std_m: float) -> Float:
    square, dof, weight, slope, links = sums
    slope = np.maximum(slope, 0.1 * weight)
    seen = dof > 0
    ratio = np.where(seen, weight * links, 1.0) / np.where(seen, slope, 1.0) ** 2
    # dof x the scores' mean square, in units of what white noise of full trust would show
    shown = np.where(seen, square * ratio / range_std_m**2, 0.0)
    excess: Float = (shown + PRIOR_DOF) / (dof + PRIOR_DOF)
    return excess


@njit(cache=True)
def _tally_blocks(
    first_row: Int,
    anchor: Int,
    residual_m: Float,
    weight: Float,
    slope: Float,
    unit: Float,
    covariance_m2: Float,
    std_m: float,
    n_anchors: int,
) -> Float:
    """(T + 1, 5) running sums over the blocks that ended before each instant, and before the end."""
    instants, d = len(first_row) - 1, unit.shape[1]
    sums = np.zeros((instants + 1, 5))
    # per link: rows, weight, slope, weighted residual, weighted direction
    link = np.zeros((n_anchors, 4 + d))
    information = np.zeros((d, d))
    for k in range(instants):
        sums[k + 1] = sums[k]
        for j in range(first_row[k], first_row[k + 1]):
            each = link[anchor[j]]
            each[0] += 1
            each[1] += weight[j]
            each[2] += slope[j]
            each[3] += weight[j] * residual_m[j]
            each[4:] += weight[j] * unit[j]
            for a in range(d):
                for b in range(d):
                    information[a, b] += weight[j] * unit[j, a] * unit[j, b] / std_m**2
        if NOISE_SHARE * np.sum(information * covariance_m2[k]) >= d:
            sums[k + 1] += _score_block(link)
            link[:] = 0.0
            information[:] = 0.0
    return sums


@njit(cache=True)
def _score_block(link: Float) -> Float:
    """(5,) what one block adds: squared scores left by the best place, degrees of freedom, weight, slope, links."""
    d = link.shape[1] - 4
    heard = link[link[:, 1] > 1e-9]
    if len(heard) <= d:
        return np.zeros(5)
    direction = heard[:, 4:] / heard[:, 1:2]
    weighted = np.ascontiguousarray(heard[:, 4:].T)
    normal = weighted @ direction + 1e-9 * np.eye(d)
    place_m = np.linalg.solve(normal, weighted @ (heard[:, 3] / heard[:, 1]))
    score = heard[:, 3] - heard[:, 1] * (direction @ place_m)
    return np.array([np.sum(score**2), len(heard) - d, np.sum(heard[:, 1]), np.sum(heard[:, 2]), float(len(heard))])
