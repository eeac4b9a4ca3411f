"""First guesses of each anchor's place: every distinct minimum of its ranges' misfit along a known walk."""

from __future__ import annotations

import numpy as np

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
    places = np.array(
        [_refined(tag_m, tag_height_m, range_m, start, height_m, height_std_m) for start in starts]
    ).reshape(-1, 4)
    misfits = np.array([_misfit(tag_m, tag_height_m, range_m, place) for place in places])
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
    edged = np.pad(misfit, 1, constant_values=np.inf)
    around = [
        edged[1 + i : CELLS + 1 + i, 1 + j : CELLS + 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)
    ]
    lowest = np.argwhere(misfit <= np.min(around, axis=0))
    best = lowest[np.argsort(misfit[tuple(lowest.T)], kind="stable")[:MOST_STARTS]]
    return np.column_stack([x_m[best[:, 0]], y_m[best[:, 1]]])


def _refined(
    tag_m: Float, tag_height_m: Float, range_m: Float, start_m: Float, height_m: float, height_std_m: float
) -> Float:
    """(4,) x_m, y_m, z_m, bias_m by damped Gauss-Newton steps of the Cauchy kernel, with priors on height and bias."""
    place = np.array([*start_m, height_m, USUAL_BIAS_M])
    mean, weight = place.copy(), np.array([0.0, 0.0, height_std_m**-2, BIAS_STD_M**-2])
    for _ in range(ROUNDS):
        residual_m, unit = _residuals(tag_m, tag_height_m, range_m, place)
        trust = 1 / (1 + (residual_m / KERNEL_M) ** 2) / KERNEL_M**2
        design = np.column_stack([unit, np.ones(len(unit))])
        normal = (design * trust[:, None]).T @ design + np.diag(weight + 1e-3)
        place = place + np.linalg.solve(normal, design.T @ (trust * residual_m) - weight * (place - mean))
    return place


def _residuals(tag_m: Float, tag_height_m: Float, range_m: Float, place: Float) -> tuple[Float, Float]:
    """Range less its prediction (N,), and unit vectors (N, 3) from the tag to the anchor."""
    offset_m = place[:3] - np.column_stack([tag_m, tag_height_m])
    distance_m = np.maximum(np.linalg.norm(offset_m, axis=1), 1e-6)
    return range_m - place[3] - distance_m, offset_m / distance_m[:, None]


def _misfit(tag_m: Float, tag_height_m: Float, range_m: Float, place: Float) -> float:
    residual_m, _ = _residuals(tag_m, tag_height_m, range_m, place)
    return float(np.log1p((residual_m / KERNEL_M) ** 2).mean())
