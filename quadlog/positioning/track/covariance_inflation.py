"""How much larger the errors of a track are than white range noise would make them, from the residuals alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadlog.messages import Float, Int

NOISE_SHARE = 0.75
"""Of a position's variance what range noise brings, the rest being motion that the filter has not followed. Exact in
the steady state under white acceleration, filtered and smoothed alike."""
PRIOR_DOF = 10.0
"""So many degrees of freedom stand for white noise before the log has shown any."""
SHORTEST_LOOK = 16
"""Instants searched at a time for a block's end, at the least."""


class ResidualSums(NamedTuple):
    """Sums over the blocks of a log: squared scores of the links, degrees of freedom, weights and slopes."""

    square: float = 0.0
    dof: float = 0.0
    weight: float = 0.0
    slope: float = 0.0
    links: float = 0.0


def excess_variance(
    tally: ResidualSums,
    first_row: Int,
    anchor: Int,
    residual_m: Float,
    weight: Float,
    slope: Float,
    unit: Float,
    covariance_m2: Float,
    range_std_m: float,
) -> tuple[Float, ResidualSums]:
    """(T,) factor on the variance that ranges bring, from what is known before each instant; and the tally after all.

    anchor, residual_m, weight, slope: (N,) of each range, slope being the derivative of weight x residual; unit (N, D)
    its direction; covariance_m2 (T, D, D) of the place. A block lasts until its ranges hold as much information as they
    bring to one pose. Within it, each link's residuals are summed as they are in the estimate (so errors that persist
    add up, white ones do not), the place is fitted once more (D degrees of freedom per block: what the track absorbed
    cannot be seen, and the other links tell how large it is), and the rest is compared with white noise. For robust
    weights this is the sandwich H^-1 S H^-1, with S the scores' and H the slopes' sum.
    """
    axes = unit.shape[1]
    steps = weight[:, None, None] * unit[:, :, None] * unit[:, None, :] / range_std_m**2
    told = np.concatenate([np.zeros((1, axes, axes)), np.cumsum(steps, axis=0)])[first_row]
    ends = _block_ends(told, covariance_m2)
    block = np.searchsorted(first_row[ends], np.arange(len(anchor)), side="right")
    scores = _score_blocks(block, len(ends), anchor, residual_m, weight, slope, unit)
    running = np.concatenate([np.array([tally]), np.array(tally) + np.cumsum(scores, axis=0)])
    over = np.searchsorted(ends, np.arange(len(first_row) - 1), side="right")
    return _excess(running[over].T, range_std_m), ResidualSums(*running[-1].tolist())


def total_excess(tally: ResidualSums, range_std_m: float) -> float:
    """The factor that a whole log shows."""
    return float(_excess(np.array(tally), range_std_m))


def _excess(sums: Float, range_std_m: float) -> Float:
    square, dof, weight, slope, links = sums
    slope = np.maximum(slope, 0.1 * weight)
    seen = dof > 0
    ratio = np.where(seen, weight * links, 1.0) / np.where(seen, slope, 1.0) ** 2
    # dof x the scores' mean square, in units of what white noise of full trust would show
    shown = np.where(seen, square * ratio / range_std_m**2, 0.0)
    excess: Float = (shown + PRIOR_DOF) / (dof + PRIOR_DOF)
    return excess


def _block_ends(told: Float, covariance_m2: Float) -> Int:
    """(B,) the instant behind each block, from information (T + 1, D, D) before and after T instants.

    A block is over where its information, times the covariance of the place there, has come to what one pose takes.
    """
    count, axes = len(covariance_m2), covariance_m2.shape[1]
    since_start = np.einsum("kij,kij->k", told[1:], covariance_m2)
    ends, begin, look = [], 0, SHORTEST_LOOK
    while begin < count:
        part = slice(begin, begin + look)
        own = since_start[part] - np.einsum("ij,kij->k", told[begin], covariance_m2[part])
        full = NOISE_SHARE * own >= axes
        if full.any():
            length = int(np.argmax(full)) + 1
            begin += length
            ends.append(begin)
            # As far as the next block is likely to last: after a long one, short ones must not be searched as widely.
            look = max(2 * length, SHORTEST_LOOK)
        elif begin + look >= count:
            break
        else:
            look *= 2
    return np.array(ends, dtype=np.int64)


def _score_blocks(
    block: Int, blocks: int, anchor: Int, residual_m: Float, weight: Float, slope: Float, unit: Float
) -> Float:
    """(B, 5) what each block adds: squared scores left by its best place, degrees of freedom, weight, slope, links.

    block (N,): of each range, B and more for those of none.
    """
    axes, n_anchors = unit.shape[1], int(anchor.max(initial=-1)) + 1
    shape, over = (blocks, n_anchors), block < blocks
    cell = (block * n_anchors + anchor)[over]

    def total(each: Float) -> Float:
        sums: Float = np.bincount(cell, each[over], blocks * n_anchors).astype(np.float64).reshape(shape)
        return sums

    trust, pull = total(weight), total(weight * residual_m)
    heard = trust > 1e-9
    links = heard.sum(axis=1)
    heard &= (links > axes)[:, None]
    trust, pull = np.where(heard, trust, 0.0), np.where(heard, pull, 0.0)
    lever = np.stack([np.where(heard, total(weight * each), 0.0) for each in unit.T], axis=2)
    direction = lever / np.where(heard, trust, 1.0)[:, :, None]
    normal = np.einsum("bai,baj->bij", lever, direction) + 1e-9 * np.eye(axes)
    place_m = np.linalg.solve(normal, np.einsum("bai,ba->bi", direction, pull)[:, :, None])[:, :, 0]
    score = pull - trust * np.einsum("bai,bi->ba", direction, place_m)
    told = links > axes
    slopes = np.where(heard, total(slope), 0.0).sum(axis=1)
    dof, counted = np.where(told, links - axes, 0), np.where(told, links, 0)
    return np.column_stack([(score**2).sum(axis=1), dof, trust.sum(axis=1), slopes, counted]).astype(np.float64)
