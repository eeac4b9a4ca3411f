"""The ranges of one tag, and velocities beside them, as the filter takes them; and a stretch of them filtered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.track.kalman import COVARIANCE, FILTERED, MotionModel, filter_ranges

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

    Causal: the last one before; else linear between two neighbours. A filter takes errors for white; so the variance of
    each of the instants is that of ERRORS_LAST_S, shared among those that fall into it.
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


START_STD = (0.5, 0.5, 1.0, 1.0)
"""How well a first fix and standing still are believed, in m and m/s; wide, because the fix's ranges are used again."""
ACCELERATION_LASTS_S = 0.1
"""Correlation time of a walker's acceleration, about half a step: density = std^2 x this, in m^2/s^3."""


@dataclass(frozen=True, slots=True)
class RangeLog:
    """All N ranges of a tag in time order, at T instants; what they are to, and what is assumed of them.

    Instant k has rows first_row[k]:first_row[k+1]. anchor (N,), and where it stands: anchor_m (N, 3). velocity_mps (T,
    2) and its variance (T,), infinite for none. fix_t_ns (F,), fix_m (F, 2): fixes, and when each was known.
    """

    instant_ns: Int
    first_row: Int
    anchor: Int
    anchor_m: Float
    range_m: Float
    velocity_mps: Float
    velocity_variance: Float
    fix_t_ns: Int
    fix_m: Float
    range_std_m: float
    motion: MotionModel

    @property
    def axes(self) -> int:
        """How many coordinates of the place are tracked: three, or two where the height is given."""
        return 3 if self.motion.height_std_m > 0 else 2

    def without(self, bias_m: Float) -> RangeLog:
        """The same log with the bias (A,) of each anchor's link subtracted from its ranges."""
        return replace(self, range_m=self.range_m - bias_m[self.anchor])

    def rows(self, begin: int, end: int) -> slice:
        """The rows of the instants [begin, end)."""
        return slice(int(self.first_row[begin]), int(self.first_row[end]))

    def seconds(self, begin: int, end: int) -> Float:
        """Time of the instants [begin, end) since the first of them."""
        return seconds_since(self.instant_ns[begin:end], int(self.instant_ns[begin]))


def walker(acceleration_std_mps2: float, height_m: float, height_std_m: float) -> MotionModel:
    """How a tag moves that is carried at a height."""
    density = acceleration_std_mps2**2 * ACCELERATION_LASTS_S
    return MotionModel(float(density), float(height_m), float(height_std_m))


def log_ranges(
    t_ns: Int,
    anchor: Int,
    range_m: Float,
    anchors_m: Float,
    fix_t_ns: Int,
    fix_m: Float,
    range_std_m: float,
    motion: MotionModel,
    velocity: VelocitySeries | None = None,
    *,
    causal: bool = False,
) -> RangeLog:
    """N ranges in time order, with anchor (N,) an index into anchors_m (A, 3); fixes (F, 2), known from fix_t_ns on.

    causal: of a measured velocity nothing is used before it was known.
    """
    instant_ns, first_row = np.unique(t_ns, return_index=True)
    return RangeLog(
        instant_ns,
        np.append(first_row, len(t_ns)),
        anchor,
        np.asarray(anchors_m, dtype=np.float64)[anchor],
        np.ascontiguousarray(range_m, dtype=np.float64),
        *sample_velocity(velocity, instant_ns, causal=causal),
        fix_t_ns,
        fix_m,
        float(range_std_m),
        motion,
    )


@dataclass(frozen=True, slots=True)
class Stretch:
    """Instants [begin, end) of a log, tracked from one fix on.

    start: the state (5,) before the first range; restarted: it begins where another track had lost the tag.
    weight: (N,); filtered (T, FILTERED): what the filter wrote with these weights; states (T, 5): of it, or smoothed.
    """

    begin: int
    end: int
    start: Float
    restarted: bool
    weight: Float
    filtered: Float
    states: Float

    @property
    def covariances(self) -> Float:
        """(T, 5, 5) as filtered."""
        return self.filtered[:, COVARIANCE].reshape(-1, 5, 5)


def filter_stretch(
    log: RangeLog, begin: int, end: int, start: Float, given_weight: Float, long_m: float, short_m: float
) -> tuple[Float, Float]:
    """Weights (N,) and what the filter wrote (T, FILTERED) of instants [begin, end) from a start state (5,)."""
    x, y, u, v = (std**2 for std in START_STD)
    z = log.motion.height_std_m**2
    covariance = (x, 0.0, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z, 0.0, 0.0, u, 0.0, v)
    first, last = int(log.first_row[begin]), int(log.first_row[end])
    weight, filtered = np.empty(last - first), np.empty((end - begin, FILTERED))
    filter_ranges(
        log.seconds(begin, end),
        log.first_row[begin : end + 1] - first,
        log.anchor_m[first:last],
        log.range_m[first:last],
        given_weight,
        log.velocity_mps[begin:end],
        log.velocity_variance[begin:end],
        tuple(start.tolist()),
        covariance,
        log.motion,
        log.range_std_m**2,
        long_m,
        short_m,
        weight,
        filtered,
    )
    return weight, filtered


def predict_rows(log: RangeLog, stretch: Stretch) -> tuple[Float, Float]:
    """(N,) distance of each range's anchor from the state at its instant, and (N, D) the direction from it."""
    rows = log.first_row[stretch.begin : stretch.end + 1]
    place_m = np.repeat(stretch.states[:, :3], np.diff(rows), axis=0)
    offset_m = place_m - log.anchor_m[rows[0] : rows[-1]]
    distance_m = np.sqrt(np.einsum("ni,ni->n", offset_m, offset_m))
    return distance_m, offset_m[:, : log.axes] / np.maximum(distance_m, 1e-9)[:, None]
