"""Anchors whose ids or places were exchanged, found from the ranges of a log alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.epochs import Epochs
from quadlog.positioning.gauss_newton import solve_gauss_newton
from quadlog.positioning.shared_errors import column_medians

MIN_RANGES = 4
"""Three ranges agree with almost any order of their anchors."""
MAX_EPOCHS = 200
"""Of each tag: tens of orders are tried, and an exchange is plain to see."""
LARGEST_BIAS_M = 0.4
"""What a link may be off by on average before its anchor is in doubt."""
COST_STD = 2.0
"""Residuals, in std, from where on a misfit counts by its order of magnitude only."""
NO_FIX_STD = 20.0
"""A range that leads to no fix counts as if it were so many std off."""
CLEARLY_BETTER = 0.7
"""One layout is better than another if its misfit is below this share. Chosen on seeds 7000 on of simulated logs, 4 to
8 anchors: the best wrong order came to 0.9 and more, the true one to 0.66 and less unless a symmetry hid it."""


@dataclass(frozen=True, slots=True)
class TagEpochs:
    """The epochs of one tag, and its height in map."""

    epochs: Epochs
    height_m: float


@dataclass(frozen=True, slots=True)
class Exchanges:
    """Which exchanges explain a log better than the configured order; one is true, where there are several.

    swapped: pairs of anchors, as indices, i < j.
    turned: steps k, where what is named anchor i fits the place of anchor i + k, around the list.
    misfit: of the best of them, or of the configured order where there is none.
    """

    swapped: tuple[tuple[int, int], ...]
    turned: tuple[int, ...]
    misfit: float


def find_exchanges(logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float) -> Exchanges:
    """Whether two anchors of (A, 3) were exchanged, or all are named by a neighbour's id.

    Every pair and every step is tried on thinned epochs of four ranges or more.
    A symmetric layout hides exchanges: those that mirror or turn it onto itself
    fit as well as the truth, and neither is named.
    """
    index = np.arange(len(anchors_m))
    heard = np.flatnonzero(sum(np.isfinite(log.epochs.range_m).any(axis=0) for log in logs))
    pairs = [(int(i), int(j)) for i, j in combinations(heard, 2)]
    steps = [] if len(heard) < len(anchors_m) else list(range(1, len(anchors_m)))
    swaps = [np.where(index == i, j, np.where(index == j, i, index)) for i, j in pairs]
    orders = [index, *swaps, *((index + k) % len(index) for k in steps)]
    misfits = np.array([layout_misfit(logs, anchors_m[order], range_std_m) for order in orders])
    best = float(misfits.min())
    if best > CLEARLY_BETTER * misfits[0]:
        return Exchanges((), (), float(misfits[0]))
    as_good = [int(i) for i in np.argsort(misfits, kind="stable") if CLEARLY_BETTER * misfits[i] <= best]
    return Exchanges(
        tuple(pairs[i - 1] for i in as_good if i <= len(pairs)),
        tuple(steps[i - 1 - len(pairs)] for i in as_good if i > len(pairs)),
        best,
    )


def layout_misfit(logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float) -> float:
    """Mean log(1 + (r / 2 std)^2) of what fixes of single epochs leave, each link's usual residual taken away.

    NaN where no epoch has four ranges.
    """
    costs = [_epoch_costs(log, anchors_m, range_std_m) for log in logs]
    cost = np.concatenate([np.empty(0), *costs])
    return float(cost.mean()) if len(cost) else float("nan")


def _epoch_costs(log: TagEpochs, anchors_m: Float, range_std_m: float) -> Float:
    range_m = log.epochs.range_m[thin_rows(np.isfinite(log.epochs.range_m).sum(axis=1) >= MIN_RANGES, MAX_EPOCHS)]
    fixes = solve_gauss_newton(anchors_m, range_m, log.height_m, range_std_m, np.inf)
    bias_m = column_medians(fixes.residual_m).clip(-LARGEST_BIAS_M, LARGEST_BIAS_M)
    off_std = np.where(fixes.solved[:, None], (fixes.residual_m - bias_m) / range_std_m, NO_FIX_STD)
    cost = np.log1p((off_std / COST_STD) ** 2)
    return np.asarray(cost[np.isfinite(range_m) & np.isfinite(cost)])


def thin_rows(usable: np.ndarray, most: int) -> Int:
    """Indices of at most so many rows among the usable ones (E,) bool, evenly spread."""
    rows = np.flatnonzero(usable)
    return rows[:: max(1, -(-len(rows) // most))]
