"""From the ranges of one tag, as they come, to a track: robust filter, smoother over the whole log."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.kalman import filter_ranges, smooth_states

LOST_AFTER_S = 2.0
"""After so long without a range the track starts anew from a fix."""
ACCELERATION_LASTS_S = 0.1
"""Correlation time of a walker's acceleration, about half a step: density = std^2 x this, in m^2/s^3."""
START_COVARIANCE = np.diag([0.5**2, 0.5**2, 1.0**2, 1.0**2])
"""How well a first fix and standing still are believed; wide, because the fix's ranges are used again."""
LONG_STD, SHORT_STD = 1.0, 4.0
"""Residuals, in std, where the causal filter's weights begin to fall: late paths exist, early ones hardly do."""
SMOOTHING_SHORT_STD = 8.0
SMOOTHING_PASSES = 8


@dataclass(frozen=True, slots=True)
class Track:
    """A tag's way at T instants.

    t_ns: (T,) strictly increasing; position_m, velocity_mps: (T, 2) in map.
    covariance_m2, velocity_covariance_m2ps2: (T, 2, 2) of each of them.
    z_m, z_std_m: (T,) height in map; where it was given instead of tracked, that, and a std of zero.
    """

    t_ns: Int
    position_m: Float
    velocity_mps: Float
    covariance_m2: Float
    velocity_covariance_m2ps2: Float
    z_m: Float
    z_std_m: Float

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class TrackedRanges:
    """A track, and what it makes of each of N ranges.

    predicted_m: (N,), NaN before the track starts. weight: (N,), one for full trust, near zero for NLOS,
    zero before the track starts.
    """

    track: Track
    predicted_m: Float
    weight: Float


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Rows of ranges between two losses, from the first fix on, indexed by instant."""

    t_s: Float
    first_row: Int
    anchor: Int
    range_m: Float
    start_state: Float


def track_ranges(
    t_ns: Int,
    anchor: Int,
    range_m: Float,
    anchors_m: Float,
    tag_height_m: float,
    fix_t_ns: Int,
    fix_m: Float,
    *,
    range_std_m: float,
    acceleration_std_mps2: float,
    smooth: bool,
) -> TrackedRanges:
    """Track one tag from N ranges in time order to anchors_m (A, 3), with anchor (N,) an index into them.

    Fixes (F, 2), known from fix_t_ns on, only tell where the track starts, at
    the beginning and after LOST_AFTER_S without ranges. Ranges are used one by
    one, so asynchronous ones need no epoch.

    Causal (smooth=False): a pose depends on ranges up to its own instant only.
    Long residuals lose weight as 1/residual, so that an NLOS burst pulls with
    bounded force, while no gate ever locks the filter out of the truth.
    Smoothed: that result, smoothed, then passes with one-sided Cauchy weights
    from the smoothed residuals; these fall fast enough to silence a burst that
    the motion before and after it contradicts.
    """
    instant_ns, first_row = np.unique(t_ns, return_index=True)
    first_row = np.append(first_row, len(t_ns)).astype(np.int64)
    density = acceleration_std_mps2**2 * ACCELERATION_LASTS_S
    slant_m2 = (tag_height_m - anchors_m[:, 2]) ** 2
    weight, predicted_m = np.zeros(len(t_ns)), np.full(len(t_ns), np.nan)
    parts: list[tuple[Int, Float, Float]] = []
    for begin, end in _stretches(instant_ns):
        fix = int(np.searchsorted(fix_t_ns, instant_ns[begin]))
        if fix == len(fix_t_ns) or fix_t_ns[fix] > instant_ns[end - 1]:
            continue
        begin = int(np.searchsorted(instant_ns, fix_t_ns[fix]))
        rows = slice(first_row[begin], first_row[end])
        stretch = _Stretch(
            seconds_since(instant_ns[begin:end], int(instant_ns[begin])),
            first_row[begin : end + 1] - first_row[begin],
            anchor[rows],
            range_m[rows],
            np.append(fix_m[fix], [0.0, 0.0]),
        )
        states, covariances, weight[rows] = _track_stretch(
            stretch, anchors_m[:, :2], slant_m2, range_std_m, density, smooth=smooth
        )
        predicted_m[rows] = _predict_rows(stretch, states, anchors_m[:, :2], slant_m2)
        parts.append((instant_ns[begin:end], states, covariances))
    return TrackedRanges(_join(parts, tag_height_m), predicted_m, weight)


def _stretches(instant_ns: Int) -> list[tuple[int, int]]:
    """[begin, end) of instants without a gap longer than LOST_AFTER_S."""
    if len(instant_ns) == 0:
        return []
    after_gap = np.flatnonzero(np.diff(instant_ns) > LOST_AFTER_S * 1e9) + 1
    return list(pairwise([0, *after_gap.tolist(), len(instant_ns)]))


def _track_stretch(
    stretch: _Stretch, anchor_xy_m: Float, slant_m2: Float, std_m: float, density: float, *, smooth: bool
) -> tuple[Float, Float, Float]:
    """States (T, 4), covariances (T, 4, 4) and weights (N,) of one stretch."""

    def run(given_weight: Float, long_m: float, short_m: float) -> tuple[Float, Float, Float]:
        return filter_ranges(
            stretch.t_s,
            stretch.first_row,
            stretch.anchor,
            stretch.range_m,
            anchor_xy_m,
            slant_m2,
            stretch.start_state,
            START_COVARIANCE,
            given_weight,
            std_m,
            density,
            long_m,
            short_m,
        )

    states, covariances, weight = run(np.ones(len(stretch.range_m)), LONG_STD * std_m, SHORT_STD * std_m)
    if not smooth:
        return states, covariances, weight
    states, covariances = smooth_states(stretch.t_s, states, covariances, density)
    for _ in range(SMOOTHING_PASSES):
        residual_m = stretch.range_m - _predict_rows(stretch, states, anchor_xy_m, slant_m2)
        scale_m = np.where(residual_m > 0, LONG_STD, SMOOTHING_SHORT_STD) * std_m
        before, weight = weight, 1 / (1 + (residual_m / scale_m) ** 2)
        filtered = run(weight, np.inf, np.inf)
        states, covariances = smooth_states(stretch.t_s, filtered[0], filtered[1], density)
        if np.abs(weight - before).max() < 0.01:
            break
    return states, covariances, weight


def _predict_rows(stretch: _Stretch, states: Float, anchor_xy_m: Float, slant_m2: Float) -> Float:
    """(N,) distance of each range's anchor from the state at its instant."""
    position_m = np.repeat(states[:, :2], np.diff(stretch.first_row), axis=0)
    offset_m = position_m - anchor_xy_m[stretch.anchor]
    predicted: Float = np.sqrt((offset_m**2).sum(axis=1) + slant_m2[stretch.anchor])
    return predicted


def _join(parts: list[tuple[Int, Float, Float]], height_m: float) -> Track:
    none = np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty((0, 4, 4))
    t_ns, states, covariances = (np.concatenate(column) for column in zip(none, *parts, strict=True))
    position_m, velocity_mps = states[:, :2].copy(), states[:, 2:].copy()
    covariance_m2, velocity_covariance_m2ps2 = covariances[:, :2, :2].copy(), covariances[:, 2:, 2:].copy()
    z_m, z_std_m = np.full(len(t_ns), height_m), np.zeros(len(t_ns))
    return Track(t_ns, position_m, velocity_mps, covariance_m2, velocity_covariance_m2ps2, z_m, z_std_m)
