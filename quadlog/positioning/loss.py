"""Whether a causal track has lost its tag although ranges keep coming: fixes that agree contradict how it moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
LOOK_AHEAD = 500
"""Fixes asked at a time, before the next ones."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for or against a causal track.

    Of F fixes in time order: fix_t_s (F,), fix_m (F, 2), the row fix_end_row
    (F,) behind the last range known with each, and the states (F, 5) of the
    track then, places and velocities. Of N ranges: row_t_s, range_m (N,) and
    anchor_m (N, 3).
    """

    fix_t_s: Float
    fix_m: Float
    fix_end_row: Int
    states: Float
    row_t_s: Float
    anchor_m: Float
    range_m: Float


def find_loss(evidence: Evidence, std_m: float, still_far: bool, first: int) -> tuple[int, int]:
    """The fix that first contradicted the causal track, and the one that made it certain; (-1, -1) for none.

    The filter may have found back by itself, so the track is continued straight
    from before the window. A loss is certain at a fix when, since then, fixes
    lie far from there, agree among themselves, and most ranges contradict that
    place too. Nothing later than that fix is used. still_far: only where the
    track itself is still far from it. first: the first fix asked.
    """
    for begin in range(max(first, FEWEST_FIXES), len(evidence.fix_t_s), LOOK_AHEAD):
        for before, known in _agreeing(evidence, _far_fixes(evidence, FAR_STD * std_m, still_far, begin), std_m):
            if _ranges_contradict(evidence, before, known, std_m):
                coasted_m, _ = _coasted(evidence, np.array([[before, known]]))
                far_m = np.hypot(*coasted_m[0].mean(axis=0))
                return int(before + 1 + np.argmax(np.hypot(*coasted_m[0].T) > far_m / 2)), int(known)
    return -1, -1


def _far_fixes(evidence: Evidence, limit_m: float, still_far: bool, begin: int) -> Int:
    """(K, 2) fixes from begin on that are far from where the track was going, after the fix before their window."""
    t_s = evidence.fix_t_s
    known = np.arange(begin, min(begin + LOOK_AHEAD, len(t_s)))
    before = _window_starts(t_s, known)
    lasted_s = t_s[known] - t_s[before]
    off_m = evidence.fix_m[known] - evidence.states[before, :2] - evidence.states[before, 3:] * lasted_s[:, None]
    far = (np.hypot(*off_m.T) >= limit_m) & (lasted_s >= WINDOW_S) & (lasted_s <= LONGEST_S)
    if still_far:
        far &= np.hypot(*(evidence.fix_m[known] - evidence.states[known, :2]).T) >= limit_m
    return np.column_stack([before, known])[far]


def _window_starts(t_s: Float, known: Int) -> Int:
    """(K,) the last fix by FEWEST_FIXES or more, and WINDOW_S or more, before each; zero where there is none."""
    start = np.searchsorted(t_s, t_s[known] - WINDOW_S, side="right")
    # The difference decides: the sum that is searched for is rounded.
    start -= t_s[known] - t_s[start.clip(max=len(t_s) - 1)] < WINDOW_S
    start -= t_s[known] - t_s[start.clip(0)] < WINDOW_S
    return np.minimum(start, known - FEWEST_FIXES).clip(0)


def _coasted(evidence: Evidence, windows: Int) -> tuple[Float, np.ndarray]:
    """(K, W, 2) fixes behind each (before, known) up to known, less where going straight on led; and which are (K, W).

    W is the longest window; beyond its end a shorter one has zeros.
    """
    before, known = windows.T
    index = before[:, None] + np.arange(1, int((known - before).max()) + 1)
    inside = index <= known[:, None]
    index = np.minimum(index, known[:, None])
    since_s = evidence.fix_t_s[index] - evidence.fix_t_s[before][:, None]
    place_m, straight_mps = evidence.states[before, :2], evidence.states[before, 3:]
    coasted_m = evidence.fix_m[index] - place_m[:, None] - since_s[:, :, None] * straight_mps[:, None]
    return coasted_m * inside[:, :, None], inside


def _agreeing(evidence: Evidence, windows: Int, std_m: float) -> Int:
    """Those of windows (K, 2) whose fixes are far on average as well, and agree among themselves."""
    if len(windows) == 0:
        return windows
    coasted_m, inside = _coasted(evidence, windows)
    n = inside.sum(axis=1)
    mean_m = coasted_m.sum(axis=1) / n[:, None]
    apart_m = (coasted_m - mean_m[:, None]) * inside[:, :, None]
    far_m, scatter_m = np.hypot(*mean_m.T), np.sqrt((apart_m**2).sum(axis=(1, 2)) / n)
    return windows[(far_m >= FAR_STD * std_m) & (scatter_m <= AGREE_SHARE * far_m)]


def _ranges_contradict(evidence: Evidence, before: int, known: int, std_m: float) -> bool:
    """Whether most ranges of the window do not fit going straight on from before it."""
    rows = slice(evidence.fix_end_row[before], evidence.fix_end_row[known])
    offset_m = evidence.states[before, :3] - evidence.anchor_m[rows]
    since_s = evidence.row_t_s[rows] - evidence.fix_t_s[before]
    offset_m[:, :2] += since_s[:, None] * evidence.states[before, 3:]
    off_m = np.abs(evidence.range_m[rows] - np.sqrt((offset_m**2).sum(axis=1)))
    return bool(np.count_nonzero(off_m > BAD_STD * std_m) > BAD_SHARE * len(off_m))
