"""Weights from the residuals of a smoothed track: late paths exist, early ones hardly do, and they last."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int

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
