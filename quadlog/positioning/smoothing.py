"""A stretch smoothed, with weights that its own smoothed residuals give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float
from quadlog.positioning.lateness import LinkWindows, link_windows, weigh_lateness
from quadlog.positioning.range_log import RangeLog, Stretch, filter_stretch, predict_rows
from quadlog.positioning.rts import smooth_states

SMOOTHING_PASSES = 8
SETTLED = 0.01
"""Weights that change by no more are final."""


def smooth_stretch(log: RangeLog, stretch: Stretch) -> Stretch:
    """The filtered stretch smoothed [RTS], then filtered and smoothed again with weights from the residuals' lateness.

    These fall fast enough to silence a burst that the motion before and after it contradicts.
    """
    instants = slice(stretch.begin, stretch.end)
    t_s = seconds_since(log.instant_ns[instants], int(log.instant_ns[stretch.begin]))
    velocity_mps, velocity_variance = log.velocity_mps[instants], log.velocity_variance[instants]
    rows = log.first_row[stretch.begin : stretch.end + 1]
    windows = _windows(log, stretch)
    instant_of_row = np.repeat(np.arange(len(t_s)), np.diff(rows))
    anchor_m, range_m = log.anchor_m[rows[0] : rows[-1]], log.range_m[rows[0] : rows[-1]]
    states, filtered, weight = np.empty((len(t_s), 5)), stretch.filtered, stretch.weight
    smooth_states(t_s, velocity_mps, velocity_variance, filtered, states)
    for _ in range(SMOOTHING_PASSES):
        offset_m = states[instant_of_row, :3] - anchor_m
        residual_m = range_m - np.sqrt(np.einsum("ni,ni->n", offset_m, offset_m))
        before, weight = weight, weigh_lateness(windows, residual_m, log.range_std_m)
        settled = np.abs(weight - before).max() < SETTLED
        weight, filtered = filter_stretch(log, stretch.begin, stretch.end, stretch.start, weight, np.inf, np.inf)
        smooth_states(t_s, velocity_mps, velocity_variance, filtered, states)
        if settled:
            break
    return replace(stretch, weight=weight, filtered=filtered, states=states)


def smoothed_slope(log: RangeLog, stretch: Stretch) -> Float:
    """(N,) how weight x residual of each range changes where the residuals about it change alike."""
    rows = slice(log.first_row[stretch.begin], log.first_row[stretch.end])
    residual_m = log.range_m[rows] - predict_rows(log, stretch)[0]
    windows, step_m = _windows(log, stretch), 0.01 * log.range_std_m
    after, before = (
        each * weigh_lateness(windows, each, log.range_std_m) for each in (residual_m + step_m, residual_m - step_m)
    )
    return (after - before) / (2 * step_m)


def _windows(log: RangeLog, stretch: Stretch) -> LinkWindows:
    t_s = seconds_since(log.instant_ns[stretch.begin : stretch.end], int(log.instant_ns[stretch.begin]))
    rows = log.first_row[stretch.begin : stretch.end + 1]
    return link_windows(np.repeat(t_s, np.diff(rows)), log.anchor[rows[0] : rows[-1]])
