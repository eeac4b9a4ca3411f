"""A tag's track in stretches: where a causal track has lost its tag although ranges keep coming, it restarts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.track.kalman import STATE
from quadlog.positioning.track.range_log import RangeLog, Stretch, filter_stretch, predict_rows
from quadlog.positioning.track.rts_smoother import smooth_stretch

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

    Of F fixes in time order: fix_t_s (F,), fix_m (F, 2), the row fix_end_row (F,) behind the last range known with
    each, and the states (F, 5) of the track then, places and velocities. Of N ranges: row_t_s, range_m (N,) and
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

    The filter may have found back by itself, so the track is continued straight from before the window. A loss is
    certain at a fix when, since then, fixes lie far from there, agree among themselves, and most ranges contradict that
    place too. Nothing later than that fix is used. still_far: only where the track itself is still far from it. first:
    the first fix asked.
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


LOST_AFTER_S = 2.0
"""After so long without a range the track restarts from a fix."""
LONG_STD, SHORT_STD = 1.0, 4.0
"""Residuals, in std, where the causal filter's weights begin to fall: late paths exist, early ones hardly do."""
FIRST_LOOK = 1000
"""Instants filtered before looking for a loss; four times as many each time there was none."""
LOOK_BACK_S, LOOK_ABOUT_S = 2.0, 0.5
"""A suspected loss is smoothed over from so long before it, and looked at for so long about it."""
SHORT_RANGE_STD, SHORT_SHARE = 4.0, 0.1
"""Ranges too short by so many std: nothing in the way makes them so, and that many mean that the track is wrong."""
LEAP_STD = 3.5
"""Change of a smoothed velocity, in std of that within a second of motion as assumed, that is no motion. Both limits
lie above what 280 suspicions on seeds 1000 to 1300 of three anchors with bursts showed, and jumps from 2 m on above
either."""
ASK_AGAIN_S = 0.25


def follow(log: RangeLog, *, causal: bool) -> Iterator[Stretch]:
    """The stretches of a log in time order, causally filtered.

    Where the tag is lost, a causal track that has not recovered restarts as soon as that is known. What will be
    smoothed knows better: it starts at the first fix that contradicted the track, lest the smoother draws the jump out;
    and where only its own first fix ever agreed with it, the track was wrong from the start and is dropped.
    """
    after_gap = np.flatnonzero(np.diff(log.instant_ns) > LOST_AFTER_S * 1e9) + 1
    for begin, end in pairwise([0, *after_gap.tolist(), len(log.instant_ns)]):
        if begin < end:
            yield from _follow_gapless(log, begin, end, causal=causal)


def _follow_gapless(log: RangeLog, begin: int, end: int, *, causal: bool) -> Iterator[Stretch]:
    fix, restarted = int(np.searchsorted(log.fix_t_ns, log.instant_ns[begin])), False
    while fix < len(log.fix_t_ns) and log.fix_t_ns[fix] <= log.instant_ns[end - 1]:
        begin = int(np.searchsorted(log.instant_ns, log.fix_t_ns[fix]))
        stretch, (since, known) = _filter_until_lost(log, begin, end, fix, restarted, causal=causal)
        if known < 0:
            yield stretch
            return
        worthless = not causal and since == fix + 1
        fix, restarted = known if causal else since, True
        cut = int(np.searchsorted(log.instant_ns, log.fix_t_ns[fix]))
        if cut > begin and not worthless:
            yield _shorten(log, stretch, cut)


def _shorten(log: RangeLog, stretch: Stretch, end: int) -> Stretch:
    n, rows = end - stretch.begin, log.first_row[end] - log.first_row[stretch.begin]
    return replace(
        stretch, end=end, weight=stretch.weight[:rows], filtered=stretch.filtered[:n], states=stretch.states[:n]
    )


def _filter_until_lost(
    log: RangeLog, begin: int, end: int, fix: int, restarted: bool, *, causal: bool
) -> tuple[Stretch, tuple[int, int]]:
    """The causal track from a fix on, up to end or beyond its first loss, and that as find_loss gives it.

    Looking further ahead step by step keeps the time linear in the log, however often the tag is lost.
    """
    start = np.array([*log.fix_m[fix], log.motion.height_m, 0.0, 0.0])
    limits_m = LONG_STD * log.range_std_m, SHORT_STD * log.range_std_m
    look, first = FIRST_LOOK, 0
    while True:
        stop = min(begin + look, end)
        all_trusted = np.ones(log.first_row[stop] - log.first_row[begin])
        weight, filtered = filter_stretch(log, begin, stop, start, all_trusted, *limits_m)
        stretch = Stretch(begin, stop, start, restarted, weight, filtered, filtered[:, STATE])
        evidence = _evidence(log, stretch, fix)
        since, known = find_loss(evidence, log.range_std_m, causal, first)
        while known >= 0 and not _is_certain(log, stretch, fix, fix + since, fix + known):
            first = int(np.searchsorted(log.fix_t_ns, log.fix_t_ns[fix + known] + round(ASK_AGAIN_S * 1e9))) - fix
            since, known = find_loss(evidence, log.range_std_m, causal, first)
        if known >= 0 or stop == end:
            return stretch, ((fix + since, fix + known) if known >= 0 else (-1, -1))
        look *= 4


def _evidence(log: RangeLog, stretch: Stretch, fix: int) -> Evidence:
    """What fixes from that one on, and the ranges, tell of the stretch."""
    instants = slice(stretch.begin, stretch.end)
    rows = log.first_row[stretch.begin : stretch.end + 1]
    behind = int(np.searchsorted(log.fix_t_ns, log.instant_ns[stretch.end - 1], side="right"))
    at = np.searchsorted(log.instant_ns[instants], log.fix_t_ns[fix:behind])
    t_s = log.seconds(stretch.begin, stretch.end)
    return Evidence(
        fix_t_s=t_s[at],
        fix_m=log.fix_m[fix:behind],
        fix_end_row=(rows[1:] - rows[0])[at],
        states=stretch.states[at],
        row_t_s=np.repeat(t_s, np.diff(rows)),
        anchor_m=log.anchor_m[rows[0] : rows[-1]],
        range_m=log.range_m[rows[0] : rows[-1]],
    )


def _is_certain(log: RangeLog, stretch: Stretch, fix: int, since: int, known: int) -> bool:
    """Whether no smooth way explains the ranges about a suspected loss, by what was known then.

    Blocked paths pull the filter away and let it go, which looks like a jump until one smooths across it: then there is
    a way, and their ranges are late. Across a true jump the smoother must leap, or find ranges too short. Where it all
    happens right after the start, the first second may be as wrong as the next: only a first fix that stands alone is
    known to be.
    """
    about_ns = log.fix_t_ns[since]
    if since > fix + 1 and about_ns - log.instant_ns[stretch.begin] < WINDOW_S * 1e9:
        return False
    begin, low, high = (
        int(np.searchsorted(log.instant_ns, about_ns + round(shift_s * 1e9)))
        for shift_s in (-LOOK_BACK_S, -LOOK_ABOUT_S, LOOK_ABOUT_S)
    )
    end = int(np.searchsorted(log.instant_ns, log.fix_t_ns[known], side="right"))
    begin = max(begin, stretch.begin)
    at = slice(begin - stretch.begin, end - stretch.begin)
    rows = log.first_row[begin : end + 1]
    start = stretch.start if begin == stretch.begin else stretch.states[at.start]
    all_trusted = np.ones(rows[-1] - rows[0])
    piece = Stretch(begin, end, start, False, all_trusted, stretch.filtered[at], stretch.states[at])
    smoothed = smooth_stretch(log, piece)
    low, high = max(low, begin), min(high, end)
    velocity_mps = smoothed.states[low - begin : high - begin, 3:]
    leap_mps = np.hypot(*(velocity_mps.max(axis=0) - velocity_mps.min(axis=0)))
    too_short = log.range_m[rows[0] : rows[-1]] - predict_rows(log, smoothed)[0] < -SHORT_RANGE_STD * log.range_std_m
    near = slice(log.first_row[low] - rows[0], log.first_row[high] - rows[0])
    leaps = leap_mps > LEAP_STD * np.sqrt(log.motion.density_m2ps3 * 2 * LOOK_ABOUT_S)
    return bool(leaps or too_short[near].mean() > SHORT_SHARE)
