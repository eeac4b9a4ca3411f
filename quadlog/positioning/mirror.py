"""Anchors near a line, or in space near a plane: two places fit their ranges, mirror images of each other."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float
from quadlog.positioning.descent import descend_all

THIN_STD = 10.0
"""Anchors this many range stds or more off their line (rms) do not take a fix for its image. At half of that one in
a thousand is, at a tenth one in ten (measured with four anchors)."""
AMBIGUOUS_STD2 = 9.0
"""Two minima whose costs differ by less, in std^2, are both possible: the likelihoods' ratio is below 90."""


def descend_both_sides(
    anchors_m: Float, range_m: Float, start_m: Float, solve_z: bool, range_std_m: float, long_m: float, short_m: float
) -> tuple[Float, Float]:
    """Positions (E, 3) and (sum w u u^T)^-1 (E, D, D) of the lower of two minima, NaN where both are possible.

    One lies downhill from start_m (E, 3), the other from its mirror image.
    Minima nearer to each other than the fix's own std count as one.
    """
    first_m, first, first_m2 = descend_all(anchors_m, range_m, start_m, solve_z, long_m, short_m)
    image_m = reflect_places(anchors_m, np.isfinite(range_m), start_m, first.shape[1])
    second_m, second, second_m2 = descend_all(anchors_m, range_m, image_m, solve_z, long_m, short_m)
    better = second_m2 < first_m2
    position_m = np.where(better[:, None], second_m, first_m)
    inverse = np.where(better[:, None, None], second, first)

    both = np.isfinite(first_m2) & np.isfinite(second_m2)
    difference_m2 = np.abs(np.where(both, first_m2, np.inf) - np.where(both, second_m2, 0.0))
    own_std_m = range_std_m * np.sqrt(np.trace(inverse, axis1=1, axis2=2))
    apart = np.linalg.norm(first_m - second_m, axis=1) > own_std_m
    ambiguous = apart & (difference_m2 < AMBIGUOUS_STD2 * range_std_m**2)
    position_m[ambiguous] = np.nan
    return position_m, inverse


def reflect_places(anchors_m: Float, heard: np.ndarray, position_m: Float, unknowns: int) -> Float:
    """(E, 3) mirror images of positions in what fits the anchors heard (E, A) best: a vertical plane through their
    line with two unknowns, their plane with three. NaN with as few anchors as unknowns.
    """
    image_m = np.full_like(position_m, np.nan)
    patterns, pattern = np.unique(heard, axis=0, return_inverse=True)
    for i in range(len(patterns)):
        if patterns[i].sum() <= unknowns:
            continue
        mine = pattern.reshape(-1) == i
        known_m = anchors_m[patterns[i], :unknowns]
        normal = np.zeros(3)
        normal[:unknowns] = np.linalg.svd(known_m - known_m.mean(axis=0))[2][-1]
        off_m = (position_m[mine, :unknowns] - known_m.mean(axis=0)) @ normal[:unknowns]
        image_m[mine] = position_m[mine] - 2 * off_m[:, None] * normal
    return image_m
