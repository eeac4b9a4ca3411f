"""A measured velocity of the tag beside its ranges, as the tracker takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int

HOLD_S = 0.5
"""A velocity speaks for instants no further away than this."""
ERRORS_LAST_S = 1.0
"""Errors of odometry persist over strides and turns: so long counts as one measurement."""


@dataclass(frozen=True, slots=True)
class VelocitySeries:
    """Velocity of a tag in map at M increasing instants: velocity_mps (M, 2), std_mps (M,) of each axis.

    A std that is infinite or NaN: no measurement.
    """

    t_ns: Int
    velocity_mps: Float
    std_mps: Float


def sample_velocity(series: VelocitySeries | None, t_ns: Int, *, causal: bool) -> tuple[Float, Float]:
    """Velocity (T, 2) at T increasing instants, and its variance (T,) in m^2/s^2, infinite where there is none.

    Causal: the last one before; else linear between two neighbours. A filter
    takes errors for white; so the variance of each of the instants is that of
    ERRORS_LAST_S, shared among those that fall into it.
    """
    velocity_mps, variance = np.zeros((len(t_ns), 2)), np.full(len(t_ns), np.inf)
    if series is None or len(series.t_ns) == 0 or len(t_ns) == 0:
        return velocity_mps, variance
    before = np.searchsorted(series.t_ns, t_ns, side="right") - 1
    after = before if causal else np.searchsorted(series.t_ns, t_ns, side="left")
    inside = np.flatnonzero((before >= 0) & (after < len(series.t_ns)))
    before, after = before[inside], after[inside]
    behind_s = (t_ns[inside] - series.t_ns[before]) * 1e-9
    ahead_s = np.abs(series.t_ns[after] - t_ns[inside]) * 1e-9
    std_mps = np.maximum(series.std_mps[before], series.std_mps[after])
    use = (np.maximum(behind_s, ahead_s) <= HOLD_S) & np.isfinite(std_mps)
    span_s = behind_s + ahead_s
    share = np.where((span_s > 0) & (before != after), behind_s / np.where(span_s > 0, span_s, 1.0), 0.0)[:, None]
    between = (1 - share) * series.velocity_mps[before] + share * series.velocity_mps[after]
    velocity_mps[inside[use]] = between[use]

    seconds = seconds_since(t_ns, int(t_ns[0]))
    lasted_s = np.diff(seconds, prepend=0.0).clip(1e-3, ERRORS_LAST_S)
    variance[inside[use]] = std_mps[use] ** 2 * (ERRORS_LAST_S / lasted_s[inside[use]])
    return velocity_mps, variance
