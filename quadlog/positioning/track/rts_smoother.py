"""A filtered stretch smoothed backwards, and weights from its residuals: late paths exist, early ones hardly do, and
they last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from quadlog.compiled import kernel
from quadlog.messages import Float, Int
from quadlog.positioning.track.kalman import COVARIANCE, HEIGHT_LASTS_S, MotionModel
from quadlog.positioning.track.range_log import RangeLog, Stretch, filter_stretch

WINDOW_S = 0.3
"""A path stays blocked for about a step at least: so long, a link's residuals are judged by their mean."""
LATE_MEAN_STD, LATE_MEAN_LEAST = 2.0, 0.4
"""A mean of n residuals is half trusted at the larger of 2 std / sqrt(n) and 0.4 std. Chosen, as all here, on
bursts of seeds 1000 to 1100 of the tests' simulation."""
LATE_STD, EARLY_STD = 3.0, 8.0
"""A single residual is half trusted so many std late or early."""
CLIP_STD = 4.0
"""What one range can say about its neighbours."""


@dataclass(frozen=True, slots=True)
class LinkWindows:
    """For N ranges sorted by link, then time: order (N,), and the window about each as [first, end) in that order."""

    order: Int
    first: Int
    end: Int


def link_windows(t_s: Float, anchor: Int) -> LinkWindows:
    """Windows of WINDOW_S about each of N ranges at increasing t_s (N,), among those of its own anchor (N,)."""
    order = np.argsort(anchor, kind="stable").astype(np.int64)
    apart_s = (float(t_s[-1] - t_s[0]) if len(t_s) else 0.0) + 2 * WINDOW_S
    key = t_s[order] + apart_s * anchor[order]
    first = np.searchsorted(key, key - WINDOW_S / 2)
    return LinkWindows(order, first, np.searchsorted(key, key + WINDOW_S / 2, side="right"))


def weigh_lateness(windows: LinkWindows, residual_m: Float, std_m: float) -> Float:
    """(N,) weights in (0, 1] of residuals (N,), measured minus smoothed.

    The mean over a window tells a blocked path from white noise much better
    than one residual does, so noise costs little and a burst is still silenced.
    The weights redescend: what the motion before and after contradicts stops pulling.
    """
    residual = residual_m[windows.order] / std_m
    total = np.append(0.0, np.cumsum(residual.clip(-CLIP_STD, CLIP_STD)))
    n = windows.end - windows.first
    mean = (total[windows.end] - total[windows.first]) / n
    late_mean = np.maximum(LATE_MEAN_STD / np.sqrt(n), LATE_MEAN_LEAST)
    by_mean = 1 / (1 + (mean / np.where(mean > 0, late_mean, EARLY_STD)) ** 2)
    weight = np.empty(len(residual))
    weight[windows.order] = by_mean / (1 + (residual / np.where(residual > 0, LATE_STD, EARLY_STD)) ** 2)
    return weight


@kernel
def smooth_states(t_s: Float, velocity_mps: Float, velocity_variance: Float, filtered: Float, smoothed: Float) -> None:
    """Writes into smoothed (T, 5) the states given all ranges, from what filter_ranges wrote.

    They are those of [RTS], without an inverse [Bryson]: the state plus its covariance times the pull, the gradient of
    the log-likelihood of all that comes later. Backwards in time, each instant's measurements join in with what they
    miss the smoothed state by.
    """
    px, py, pz, pu, pv = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(t_s) - 1, -1, -1):
        for i in range(5):
            smoothed[k, i] = (
                filtered[k, 5 * i + 5] * px
                + filtered[k, 5 * i + 6] * py
                + filtered[k, 5 * i + 7] * pz
                + filtered[k, 5 * i + 8] * pu
                + filtered[k, 5 * i + 9] * pv
            )
        x, y, z = smoothed[k, 0], smoothed[k, 1], smoothed[k, 2]
        lxx, lxy, lxz, lyy, lyz, lzz = (
            filtered[k, 30], filtered[k, 31], filtered[k, 32], filtered[k, 33], filtered[k, 34], filtered[k, 35]
        )  # fmt: skip
        px += filtered[k, 36] - lxx * x - lxy * y - lxz * z
        py += filtered[k, 37] - lxy * x - lyy * y - lyz * z
        pz += filtered[k, 38] - lxz * x - lyz * y - lzz * z
        for i in range(5):
            smoothed[k, i] += filtered[k, i]
        pu += (velocity_mps[k, 0] - smoothed[k, 3]) / velocity_variance[k]
        pv += (velocity_mps[k, 1] - smoothed[k, 4]) / velocity_variance[k]
        if k > 0:
            dt_s = t_s[k] - t_s[k - 1]
            pu, pv, pz = pu + dt_s * px, pv + dt_s * py, pz * math.exp(-dt_s / HEIGHT_LASTS_S)


def smooth_covariances(t_s: Float, filtered: Float, motion: MotionModel) -> Float:
    """(T, 5, 5) covariances given all ranges, from what filter_ranges wrote: C + G (C' - F C F^T - Q) G^T."""
    covariances = filtered[:, COVARIANCE].reshape(-1, 5, 5)
    return smooth_backwards(covariances, *_predict_covariances(covariances[:-1], np.diff(t_s), motion))


def smooth_backwards(covariances: Float, moved: Float, ahead: Float) -> Float:
    """(T, S, S) given all measurements, from filtered ones C (T, S, S) and the predictions of all but the last.

    moved, ahead: (T - 1, S, S) F C and F C F^T + Q.
    """
    gain = np.linalg.solve(ahead, moved).transpose(0, 2, 1)
    rest = covariances[:-1] - gain @ ahead @ gain.transpose(0, 2, 1)
    rest = (rest + rest.transpose(0, 2, 1)) / 2
    smoothed = covariances.copy()
    for k in range(len(covariances) - 2, -1, -1):
        smoothed[k] = rest[k] + gain[k] @ smoothed[k + 1] @ gain[k].T
    return (smoothed + smoothed.transpose(0, 2, 1)) / 2


def _predict_covariances(covariances: Float, dt_s: Float, motion: MotionModel) -> tuple[Float, Float]:
    """F C and F C F^T + Q (K, 5, 5), dt_s (K,) after C, as predict_state has them.

    A height that is given gets a variance there, of which the gain takes nothing: so it has an inverse.
    """
    moved = _move(covariances, dt_s)
    ahead = _move(moved.transpose(0, 2, 1), dt_s)
    for place, speed in ((0, 3), (1, 4)):
        ahead[:, place, place] += motion.density_m2ps3 * dt_s**3 / 3
        ahead[:, place, speed] += motion.density_m2ps3 * dt_s**2 / 2
        ahead[:, speed, place] += motion.density_m2ps3 * dt_s**2 / 2
        ahead[:, speed, speed] += motion.density_m2ps3 * dt_s
    if motion.height_std_m > 0:
        ahead[:, 2, 2] -= motion.height_std_m**2 * np.expm1(-2 * dt_s / HEIGHT_LASTS_S)
    else:
        ahead[:, 2, 2] = 1.0
    return moved, ahead


def _move(rows: Float, dt_s: Float) -> Float:
    """F @ rows for rows (K, 5, 5): position moves with velocity, a height falls back to its mean."""
    moved = rows.copy()
    moved[:, :2] += dt_s[:, None, None] * rows[:, 3:]
    moved[:, 2] *= np.exp(-dt_s / HEIGHT_LASTS_S)[:, None]
    return moved


SMOOTHING_PASSES = 8
SETTLED = 0.01
"""Weights that change by no more are final."""


def refilter(log: RangeLog, stretch: Stretch, weight: Float) -> Stretch:
    """The stretch filtered and smoothed [RTS] once, with weights (N,) that stay as they are."""
    weight, filtered = filter_stretch(log, stretch.begin, stretch.end, stretch.start, weight, np.inf, np.inf)
    instants, states = slice(stretch.begin, stretch.end), np.empty((stretch.end - stretch.begin, 5))
    t_s = log.seconds(stretch.begin, stretch.end)
    smooth_states(t_s, log.velocity_mps[instants], log.velocity_variance[instants], filtered, states)
    return replace(stretch, weight=weight, filtered=filtered, states=states)


def refilter_usual(log: RangeLog, stretch: Stretch, late_m: Float) -> Stretch:
    """The stretch smoothed with all of its ranges, in full trust, which its weights (N,) only shorten by late_m (N,).

    For ranges with unknown biases: without one of them, the others' biases would pull the place aside. A range of
    weight w keeps that share of what it is late by, and is what its link usually has instead.
    """
    rows = log.rows(stretch.begin, stretch.end)
    range_m = log.range_m.copy()
    range_m[rows] -= (1 - stretch.weight) * late_m
    whole = refilter(replace(log, range_m=range_m), stretch, (stretch.weight > 0).astype(np.float64))
    return replace(whole, weight=stretch.weight)


def smooth_stretch(log: RangeLog, stretch: Stretch) -> Stretch:
    """The filtered stretch smoothed [RTS], then filtered and smoothed again with weights from the residuals' lateness.

    These fall fast enough to silence a burst that the motion before and after it contradicts.
    """
    rows, windows = log.rows(stretch.begin, stretch.end), windows_of(log, stretch)
    counts = np.diff(log.first_row[stretch.begin : stretch.end + 1])
    instant_of_row = np.repeat(np.arange(len(counts)), counts)
    anchor_m, range_m = log.anchor_m[rows], log.range_m[rows]
    states: Float = np.empty((stretch.end - stretch.begin, 5))
    weight = stretch.weight
    instants = slice(stretch.begin, stretch.end)
    t_s = log.seconds(stretch.begin, stretch.end)
    smooth_states(t_s, log.velocity_mps[instants], log.velocity_variance[instants], stretch.filtered, states)
    for _ in range(SMOOTHING_PASSES):
        offset_m = states[instant_of_row, :3] - anchor_m
        residual_m = range_m - np.sqrt(np.einsum("ni,ni->n", offset_m, offset_m))
        before, weight = weight, weigh_lateness(windows, residual_m, log.range_std_m)
        stretch = refilter(log, stretch, weight)
        states = stretch.states
        if np.abs(weight - before).max() < SETTLED:
            break
    return stretch


def windows_of(log: RangeLog, stretch: Stretch) -> LinkWindows:
    """The windows about the ranges of a stretch."""
    rows = log.rows(stretch.begin, stretch.end)
    counts = np.diff(log.first_row[stretch.begin : stretch.end + 1])
    return link_windows(np.repeat(log.seconds(stretch.begin, stretch.end), counts), log.anchor[rows])
