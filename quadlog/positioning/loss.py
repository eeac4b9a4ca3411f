"""Whether a causal track has lost its tag although ranges keep coming: fixes that agree contradict how it moved."""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.messages import Float, Int

WINDOW_S = 1.0
"""So long fixes must contradict the track: longer than a blocked path moves the fixes of three anchors."""
LONGEST_S = 2.0
FEWEST_FIXES = 4
"""A window reaches further back for so many fixes, as far as LONGEST_S."""
FAR_STD = 10.0
"""Distance of the fixes from the track, in std of a range; what constant biases of 0.3 m do stays well below."""
AGREE_SHARE = 1 / 3
"""The fixes' scatter about their mean offset, as a share of it; a turn makes offsets that grow, which scatter more."""
BAD_STD, BAD_SHARE = 4.0, 0.5
"""Residuals beyond so many std are bad; so many of them must be, which a few blocked paths cannot bring about."""


@njit(cache=True)
def find_loss(
    fix_t_s: Float,
    fix_m: Float,
    fix_end_row: Int,
    state: Float,
    place_m: Float,
    row_t_s: Float,
    row_anchor_m: Float,
    range_m: Float,
    std_m: float,
    still_far: bool,
    first: int,
) -> tuple[int, int]:
    """The fix that first contradicted the causal track, and the one that made it certain; (-1, -1) for none.

    Of F fixes in time order: fix_t_s (F,), fix_m (F, 2), the row fix_end_row
    (F,) behind the last range known with each, and state (F, 4) and place_m
    (F, 3) of the track then. Of N ranges: row_t_s, range_m (N,), row_anchor_m
    (N, 3). The filter may have found back by itself, so the track is continued
    straight from before the window. A loss is certain at a fix when, since
    then, fixes lie far from there, agree among themselves, and most ranges
    contradict that place too. Nothing later than that fix is used.
    still_far: only where the track itself is still far from it. first: the first fix asked.
    """
    for known in range(first, len(fix_t_s)):
        before = known - FEWEST_FIXES
        while before > 0 and fix_t_s[known] - fix_t_s[before] < WINDOW_S:
            before -= 1
        lasted_s = fix_t_s[known] - fix_t_s[max(before, 0)]
        if before < 0 or lasted_s < WINDOW_S or lasted_s > LONGEST_S:
            continue
        straight, limit_m = state[before, 2:4], FAR_STD * std_m
        off_m = fix_m[known] - state[before, :2] - straight * lasted_s
        if np.hypot(off_m[0], off_m[1]) < limit_m:
            continue
        coasted_m = fix_m[before + 1 : known + 1] - state[before, :2]
        for i in range(len(coasted_m)):
            coasted_m[i] -= straight * (fix_t_s[before + 1 + i] - fix_t_s[before])
        mean_x, mean_y = coasted_m[:, 0].mean(), coasted_m[:, 1].mean()
        far_m = np.hypot(mean_x, mean_y)
        scatter_m = np.sqrt(((coasted_m[:, 0] - mean_x) ** 2 + (coasted_m[:, 1] - mean_y) ** 2).mean())
        off_m = fix_m[known] - state[known, :2]
        found_back = np.hypot(off_m[0], off_m[1]) < limit_m
        if far_m < limit_m or scatter_m > AGREE_SHARE * far_m or (still_far and found_back):
            continue
        rows = slice(fix_end_row[before], fix_end_row[known])
        since_s = row_t_s[rows] - fix_t_s[before]
        bad = _bad_share(place_m[before], straight, since_s, row_anchor_m[rows], range_m[rows], std_m)
        if bad > BAD_SHARE:
            contradicts = np.hypot(coasted_m[:, 0], coasted_m[:, 1]) > far_m / 2
            return before + 1 + int(np.argmax(contradicts)), known
    return -1, -1


@njit(cache=True)
def _bad_share(
    place_m: Float, velocity_mps: Float, since_s: Float, anchor_m: Float, range_m: Float, std_m: float
) -> float:
    """Share of M ranges that contradict going on straight from place_m (3,)."""
    bad = 0
    for j in range(len(range_m)):
        dx = place_m[0] + velocity_mps[0] * since_s[j] - anchor_m[j, 0]
        dy = place_m[1] + velocity_mps[1] * since_s[j] - anchor_m[j, 1]
        dz = place_m[2] - anchor_m[j, 2]
        bad += abs(range_m[j] - np.sqrt(dx * dx + dy * dy + dz * dz)) > BAD_STD * std_m
    return bad / max(len(range_m), 1)
