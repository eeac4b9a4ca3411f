"""A stretch smoothed, with weights that its own smoothed residuals give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float
from quadlog.positioning.kalman import smooth_states
from quadlog.positioning.lateness import LinkWindows, link_windows, weigh_lateness
from quadlog.positioning.range_log import RangeLog, Stretch, filter_stretch, predict_rows

SMOOTHING_PASSES = 8
SETTLED = 0.01
"""Weights that change by no more are final."""


def smooth_stretch(log: RangeLog, stretch: Stretch) -> Stretch:
    """The filtered stretch smoothed [RTS], then filtered and smoothed again with weights from the residuals' lateness.

    These fall fast enough to silence a burst that the motion before and after it contradicts.
    """
    t_s = seconds_since(log.instant_ns[stretch.begin : stretch.end], int(log.instant_ns[stretch.begin]))
    windows = _windows(log, stretch)
    states, covariances = smooth_states(t_s, stretch.states, stretch.covariances, log.motion)
    stretch = replace(stretch, states=states, covariances=covariances)
    for _ in range(SMOOTHING_PASSES):
        weight = weigh_lateness(windows, _residuals(log, stretch), log.range_std_m)
        settled = np.abs(weight - stretch.weight).max() < SETTLED
        states, covariances, _ = filter_stretch(log, stretch.begin, stretch.end, stretch.start, weight, np.inf, np.inf)
        states, covariances = smooth_states(t_s, states, covariances, log.motion)
        stretch = replace(stretch, states=states, covariances=covariances, weight=weight)
        if settled:
            break
    return stretch


def smoothed_slope(log: RangeLog, stretch: Stretch) -> Float:
    """(N,) how weight x residual of each range changes where the residuals about it change alike."""
    windows, residual_m, step_m = _windows(log, stretch), _residuals(log, stretch), 0.01 * log.range_std_m
    after, before = (
        each * weigh_lateness(windows, each, log.range_std_m) for each in (residual_m + step_m, residual_m - step_m)
    )
    return (after - before) / (2 * step_m)


def _residuals(log: RangeLog, stretch: Stretch) -> Float:
    return log.range_m[log.first_row[stretch.begin] : log.first_row[stretch.end]] - predict_rows(log, stretch)[0]


def _windows(log: RangeLog, stretch: Stretch) -> LinkWindows:
    t_s = seconds_since(log.instant_ns[stretch.begin : stretch.end], int(log.instant_ns[stretch.begin]))
    rows = log.first_row[stretch.begin : stretch.end + 1]
    return link_windows(np.repeat(t_s, np.diff(rows)), log.anchor[rows[0] : rows[-1]])
