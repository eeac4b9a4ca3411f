"""First guesses of each anchor's place: every distinct minimum of its ranges' misfit along a known walk."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import minimum_filter

from quadlog.messages import Float

CELLS = 70
"""Cells of the search along each side."""
MOST_ROWS = 240
MOST_STARTS = 6
ROUNDS = 15
KERNEL_M = 0.3
"""Misfits beyond this count by their order of magnitude."""
APART_M = 0.5
"""Two minima nearer to each other are one."""
USUAL_BIAS_M, BIAS_STD_M = 0.15, 0.15


def anchor_candidates(
    tag_m: Float, tag_height_m: Float, range_m: Float, height_m: float, height_std_m: float
) -> tuple[Float, Float]:
    """Places (C, 4) x_m, y_m, z_m, bias_m of one anchor that fit its ranges (N,) locally best, and their misfits (C,).

    tag_m (N, 2) and tag_height_m (N,): where the tag was. height_m: the anchor's expected height, and its std. Sorted
    by misfit, which is the mean of log(1 + (r / KERNEL_M)^2); the first is the best.
    """
    rows = np.arange(len(range_m))[:: max(1, -(-len(range_m) // MOST_ROWS))]
    tag_m, tag_height_m, range_m = tag_m[rows], tag_height_m[rows], range_m[rows]
    starts = _grid_minima(tag_m, tag_height_m, range_m, height_m)
    spatial_m, expected = np.column_stack([tag_m, tag_height_m]), (height_m, height_std_m)
    refined = [_refined(spatial_m, range_m, start_m, expected) for start_m in starts]
    places, misfits = np.array([place for place, _ in refined]).reshape(-1, 4), np.array([each for _, each in refined])
    kept: list[int] = []
    for index in np.argsort(misfits, kind="stable"):
        if all(np.hypot(*(places[index, :2] - places[other, :2])) > APART_M for other in kept):
            kept.append(int(index))
    return places[kept], misfits[kept]


def _grid_minima(tag_m: Float, tag_height_m: Float, range_m: Float, height_m: float) -> Float:
    """(S, 2) cells of a grid around the walk with less misfit than their neighbours, best first."""
    reach_m = float(np.quantile(range_m, 0.9))
    low_m, high_m = tag_m.min(axis=0) - reach_m, tag_m.max(axis=0) + reach_m
    x_m, y_m = (np.linspace(low_m[axis], high_m[axis], CELLS) for axis in range(2))
    cell_m = max(x_m[1] - x_m[0], y_m[1] - y_m[0])
    ground_m = np.sqrt(np.maximum((range_m - USUAL_BIAS_M) ** 2 - (height_m - tag_height_m) ** 2, 0.0))
    misfit = np.zeros((CELLS, CELLS))
    for (tag_x_m, tag_y_m), far_m in zip(tag_m.tolist(), ground_m.tolist(), strict=True):
        off_m = np.hypot(x_m[:, None] - tag_x_m, y_m - tag_y_m) - far_m
        misfit += np.log1p((off_m / (KERNEL_M + cell_m)) ** 2)
    lowest = np.argwhere(misfit <= minimum_filter(misfit, 3, mode="constant", cval=np.inf))
    best = lowest[np.argsort(misfit[tuple(lowest.T)], kind="stable")[:MOST_STARTS]]
    return np.column_stack([x_m[best[:, 0]], y_m[best[:, 1]]])


def _refined(tag_m: Float, range_m: Float, start_m: Float, expected: tuple[float, float]) -> tuple[Float, float]:
    """(4,) x_m, y_m, z_m, bias_m by damped Gauss-Newton steps of the Cauchy kernel, and its misfit.

    tag_m: (N, 3). Priors on height, with its expected mean and std, and bias.
    """
    place = np.array([*start_m, expected[0], USUAL_BIAS_M])
    mean, weight = place.copy(), np.array([0.0, 0.0, expected[1] ** -2, BIAS_STD_M**-2])
    for round_ in range(ROUNDS + 1):
        offset_m = place[:3] - tag_m
        distance_m = np.maximum(np.linalg.norm(offset_m, axis=1), 1e-6)
        off = 1 + ((range_m - place[3] - distance_m) / KERNEL_M) ** 2
        if round_ == ROUNDS:
            break
        design = np.column_stack([offset_m / distance_m[:, None], np.ones(len(tag_m))])
        weighted = design / (off * KERNEL_M**2)[:, None]
        pull = weighted.T @ (range_m - place[3] - distance_m) - weight * (place - mean)
        place = place + np.linalg.solve(weighted.T @ design + np.diag(weight + 1e-3), pull)
    return place, float(np.log(off).mean())
