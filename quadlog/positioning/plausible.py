"""Whether a robot can have walked a track: its speed, its jumps, and odometry of the same walk beside it."""

from __future__ import annotations

import numpy as np

from quadlog.geometry import interpolate_poses
from quadlog.messages import Float, Int
from quadlog.planning.protocol import Bool
from quadlog.positioning.odometry import LEG_S
from quadlog.positioning.unlocated import MAX_UNMEASURED_NS

LEAST_JUMP_M, NOISE_TIMES = 0.3, 6.0
"""A jump is longer than the first, and than so many times the track's own noise."""
SPEED_OVER_NS = 250_000_000
"""Speeds are those over so long at least: over a single short step, noise is speed."""
CONTRADICTION_TIMES, CONTRADICTION_M = 1.5, 0.3
"""Ways of LEG_S that differ by more than both are not of one walk."""


def jumps(t_ns: Int, xy_m: Float, most_mps: float) -> Bool:
    """(N-1,) which steps of a track (N,), (N, 2) are longer than that speed and the track's noise allow."""
    near_m = np.full(len(t_ns), np.inf)
    for rows in range(1, min(5, len(t_ns))):  # the noise, also where several senders take turns
        apart_m = np.hypot(*(xy_m[rows:] - xy_m[:-rows]).T)
        near_m[rows:], near_m[:-rows] = np.fmin(near_m[rows:], apart_m), np.fmin(near_m[:-rows], apart_m)
    least_m = max(LEAST_JUMP_M, NOISE_TIMES * float(np.median(near_m)))
    return np.hypot(*np.diff(xy_m, axis=0).T) > np.maximum(least_m, most_mps * 1e-9 * np.diff(t_ns))


def speeds(t_ns: Int, xy_m: Float, jumped: Bool) -> tuple[Float, Float]:
    """(N,) speed over SPEED_OVER_NS from each row on, but for jumps (N-1,), NaN at gaps; (N,) s to the next row."""
    way_m = np.concatenate([np.zeros((1, 2)), np.cumsum(np.where(jumped[:, None], 0.0, np.diff(xy_m, axis=0)), axis=0)])
    later = np.minimum(np.searchsorted(t_ns, t_ns + SPEED_OVER_NS), len(t_ns) - 1)
    over_ns = t_ns[later] - t_ns
    known = (over_ns >= SPEED_OVER_NS) & (over_ns <= MAX_UNMEASURED_NS)
    speed_mps = np.hypot(*(way_m[later] - way_m).T) / (np.maximum(over_ns, 1) * 1e-9)
    return np.where(known, speed_mps, np.nan), np.append(np.diff(t_ns), 0) * 1e-9


def ways_beside(t_ns: Int, xy_m: Float, other_ns: Int, other_m: Float) -> tuple[Float, Bool]:
    """(2, W) how far both tracks lead within LEG_S, twice a second where both are known; (W,) which contradict."""
    begin_ns = t_ns[np.unique(t_ns // 500_000_000, return_index=True)[1]]
    ends_ns, ways = np.concatenate([begin_ns, begin_ns + round(LEG_S * 1e9)]), list[Float]()
    for known_ns, known_m in ((t_ns, xy_m), (other_ns, other_m)):
        ends_m, _, _ = interpolate_poses(ends_ns, known_ns, known_m, np.zeros(len(known_ns)), MAX_UNMEASURED_NS * 1e-9)
        ways.append(np.hypot(*np.diff(ends_m.reshape(2, -1, 2), axis=0)[0].T))
    ways_m = np.stack(ways)
    ways_m = ways_m[:, np.isfinite(ways_m).all(axis=0)]
    low_m, high_m = np.sort(ways_m, axis=0)
    moving = high_m > CONTRADICTION_M
    return ways_m[:, moving], (high_m > CONTRADICTION_TIMES * low_m + CONTRADICTION_M)[moving]
