"""Yaw in map: that of another sensor, turned onto the course of the track, with its uncertainty.

One tag gives no heading. While its carrier walks forward, the course does;
one degree of error moves an obstacle 10 m away by 17 cm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import interpolate_angle, seconds_since, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.heading.yaw_offset import (
    GROUP_NS,
    LOOK_S,
    UNKNOWN_YAW_STD_RAD,
    CourseDifferences,
    SensorDrift,
    fit_offset,
)
from quadlog.positioning.motion import Track

HOLD_BELOW_MPS = 0.2
TURN_STD_RADPS = 0.5
"""A yaw that is only held is off by so much after a second, by twice that after two: walkers turn on the spot."""
LONGEST_LAG_S = 2.0


def course_heading(track: Track, before_motion_rad: float | None = None) -> Float:
    """(T,) yaw along the velocity, held where the speed is below HOLD_BELOW_MPS.

    Before the first motion: before_motion_rad, which a causal track must give, since the first course lies in its
    future; None takes that first course. A track that never moves has yaw zero, or before_motion_rad.
    """
    source, known = _course_source(track, before_motion_rad)
    course = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0])
    return wrap_angle(np.where(known, course[source], before_motion_rad or 0.0))


def course_heading_std(track: Track, before_motion_rad: float | None = None, lag_s: Float | float = 0.0) -> Float:
    """(T,) std of course_heading with the same arguments, for a carrier that looks where it walks.

    That of the velocity across the course over the speed. While held it grows by TURN_STD_RADPS times the time since;
    so it does by lag_s, (T,) or one, by which the velocity is late. A before_motion_rad is worth nothing.
    """
    if len(track) == 0:
        return np.empty(0)
    source, known = _course_source(track, before_motion_rad)
    held_s = np.abs(track.t_ns - track.t_ns[source]) * 1e-9 + lag_s
    std = np.hypot(course_std(track)[source], TURN_STD_RADPS * held_s)
    return np.where(known, np.minimum(std, UNKNOWN_YAW_STD_RAD), UNKNOWN_YAW_STD_RAD)


def _course_source(track: Track, before_motion_rad: float | None) -> tuple[Int, np.ndarray]:
    """(T,) the instant whose course counts at each instant, and whether there is one."""
    moving = speed_of(track) >= HOLD_BELOW_MPS
    source = np.maximum.accumulate(np.where(moving, np.arange(len(track)), -1))
    if before_motion_rad is None and moving.any():
        source = np.where(source >= 0, source, np.argmax(moving))
    return source.clip(0), source >= 0


def speed_of(track: Track) -> Float:
    """(T,) length of the velocity."""
    speed: Float = np.hypot(track.velocity_mps[:, 0], track.velocity_mps[:, 1])
    return speed


def course_std(track: Track) -> Float:
    """(T,) std of the velocity across the course over the speed, large where it is near zero."""
    speed = np.maximum(speed_of(track), 1e-9)
    across = np.stack([-track.velocity_mps[:, 1], track.velocity_mps[:, 0]], axis=1) / speed[:, None]
    variance = np.einsum("ni,nij,nj->n", across, track.velocity_covariance_m2ps2, across)
    return np.sqrt(np.maximum(variance, 0.0)) / speed


def filter_lag_s(track: Track) -> Float:
    """(T,) how late the velocity of a causal track is: the lag of a constant-velocity filter in its steady state.

    From true to filtered velocity it is w^2 / (s^2 + sqrt(2) w s + w^2), with
    w^2 the ratio of the variances of velocity and position that the filter works with: a lag of sqrt(2) / w.
    """
    position_m2 = np.trace(track.covariance_m2, axis1=1, axis2=2) / track.position_excess
    velocity_m2ps2 = np.trace(track.velocity_covariance_m2ps2, axis1=1, axis2=2)
    lag: Float = np.sqrt(2 * position_m2 / np.maximum(velocity_m2ps2, 1e-12)).clip(max=LONGEST_LAG_S)
    return lag


TOLD_BY_STD = 2.0
"""A course counts for an offset where the speed exceeds its own std by this: noise has a course too."""
MIN_COURSE_STD_RAD = np.radians(1.0)
"""Nobody walks straighter than this, however well the track is known."""
RATE_NS = 250_000_000
"""Yaw rates are means over so much to either side, which is as sharp as a track is."""
NO_DRIFT = SensorDrift()
IMU_DRIFT = SensorDrift(rate_std_radps=0.001, walk_std=0.001)
ODOMETRY_DRIFT = SensorDrift(rate_std_radps=0.003, walk_std=0.003)
"""Orientations of consumer IMUs drift by degrees a minute, of legged or wheeled odometry by ten: orders, not tuned."""
REFIT_GROWTH = 1.05
REFIT_GROUPS = 50
"""A causal offset is fitted again when its groups have grown by 5 %, or by ten seconds of motion."""


@dataclass(frozen=True, slots=True)
class AlignedHeading:
    """Yaw in map at the track's T instants, and how it was obtained.

    yaw_rad: (T,) in [-pi, pi); yaw_std_rad: (T,) at most pi / sqrt(3), that of a direction of which nothing is known.
    offset_rad: added to the sensor's yaw in the middle of the motion, and its std_rad, infinite where the track
    never moved (for long) while the sensor gave yaw, or its course has nothing in common with it.
    drift_radps, drift_std_radps: of the offset.
    moving_s: seconds of motion it rests on. spread_rad: median absolute difference of the course from yaw_rad.
    askew_share: of the motion, where the course lies more than 60 degrees off: sideways or backward steps.
    """

    yaw_rad: Float
    yaw_std_rad: Float
    offset_rad: float = 0.0
    std_rad: float = np.inf
    drift_radps: float = 0.0
    drift_std_radps: float = 0.0
    moving_s: float = 0.0
    spread_rad: float = np.inf
    askew_share: float = 0.0

    @property
    def told(self) -> bool:
        """Whether the course showed how the sensor is turned."""
        return bool(np.isfinite(self.std_rad))


@dataclass(frozen=True, slots=True)
class CausalHeading:
    """Yaw in map at the track's T instants, its std as it was known then, and spread_rad as in AlignedHeading: (T,)."""

    yaw_rad: Float
    yaw_std_rad: Float
    spread_rad: Float

    @property
    def told(self) -> np.ndarray:
        """(T,) bool, whether the course had shown until then how the sensor is turned."""
        return np.isfinite(self.spread_rad)


@dataclass(frozen=True, slots=True)
class TagsYaw:
    """Yaw (T,) of base at a track's instants from the lever arms of several tags, and its std (T,).

    constant_std_rad: the part of the std that is the same error all along.
    """

    yaw_rad: Float
    std_rad: Float
    constant_std_rad: float


def align_yaw(
    track: Track,
    yaw_t_ns: Int,
    yaw_rad: Float,
    tag_ahead_m: float = 0.0,
    drift: SensorDrift = NO_DRIFT,
    by_tags: TagsYaw | None = None,
) -> AlignedHeading:
    """Turn a sensor's yaw (M,) at increasing yaw_t_ns by the offset that fits the track's course best.

    The offset is constant, or for a sensor with a drift rate a line in time; see fit_offset. It is fitted to course
    minus yaw over moving instants where the sensor was on, weighted with one over the course's variance. A tag that
    sits tag_ahead_m in front of base swings out in turns, by arcsin(yaw rate x tag_ahead_m / speed), which is taken
    out. Where nothing moved, or course and yaw have nothing in common, the offset is zero and its std infinite.
    by_tags: takes the place of the course, also at rest.
    """
    if len(yaw_t_ns) == 0:
        return AlignedHeading(np.zeros(len(track)), np.full(len(track), UNKNOWN_YAW_STD_RAD))
    sensor = interpolate_angle(track.t_ns, yaw_t_ns, yaw_rad)
    if by_tags is None:
        differences, _ = _differences(track, yaw_t_ns, yaw_rad, tag_ahead_m, np.zeros(len(track)))
    else:
        differences, _ = _tag_differences(track, yaw_t_ns, yaw_rad, by_tags)
    if len(differences.t_s) == 0:
        return AlignedHeading(sensor, np.full(len(track), UNKNOWN_YAW_STD_RAD))
    fit = fit_offset(differences, drift)
    moving_s = float(len(np.unique(differences.t_s // LOOK_S)))
    if not fit.told:
        return AlignedHeading(sensor, np.full(len(track), UNKNOWN_YAW_STD_RAD), moving_s=moving_s)
    t_s = seconds_since(track.t_ns, int(track.t_ns[0]))
    offset_std, drift_std = np.sqrt(np.diag(fit.covariance))
    constant_std = 0.0 if by_tags is None else by_tags.constant_std_rad
    return AlignedHeading(
        yaw_rad=wrap_angle(sensor + fit.at(t_s)),
        yaw_std_rad=_with_silence(np.hypot(fit.std_at(t_s), constant_std), track.t_ns, yaw_t_ns),
        offset_rad=fit.offset_rad,
        std_rad=float(np.hypot(offset_std, constant_std)),
        drift_radps=fit.drift_radps,
        drift_std_radps=float(drift_std),
        moving_s=moving_s,
        spread_rad=fit.spread_rad,
        askew_share=fit.askew_share,
    )


def align_yaw_causally(
    track: Track,
    yaw_t_ns: Int,
    yaw_rad: Float,
    tag_ahead_m: float = 0.0,
    drift: SensorDrift = NO_DRIFT,
    by_tags: TagsYaw | None = None,
) -> CausalHeading:
    """The sensor's yaw (M,) aligned to the course up to each instant, by nothing before.

    The fit of align_yaw to what was known then: again whenever there is REFIT_GROWTH as much of it. Until the first
    motion the sensor's yaw is not turned, and its std that of a direction of which nothing is known.
    """
    told, std = np.zeros(len(track)), np.full(len(track), UNKNOWN_YAW_STD_RAD)
    spread = np.full(len(track), np.inf)
    if len(yaw_t_ns) == 0 or len(track) == 0:
        return CausalHeading(told, std, spread)
    if by_tags is None:
        differences, over_ns = _differences(track, yaw_t_ns, yaw_rad, tag_ahead_m, filter_lag_s(track))
    else:
        differences, over_ns = _tag_differences(track, yaw_t_ns, yaw_rad, by_tags)
    constant_std = 0.0 if by_tags is None else by_tags.constant_std_rad
    t_s = seconds_since(track.t_ns, int(track.t_ns[0]))
    counts = _refits(len(over_ns))
    begins = np.append(np.searchsorted(track.t_ns, over_ns[np.array(counts, dtype=np.int64) - 1]), len(track))
    for count, begin, end in zip(counts, begins[:-1], begins[1:], strict=True):
        fit = fit_offset(differences.until(count), drift)
        told[begin:end] = fit.at(t_s[begin:end])
        if fit.told:
            std[begin:end], spread[begin:end] = np.hypot(fit.std_at(t_s[begin:end]), constant_std), fit.spread_rad
    sensor = interpolate_angle(track.t_ns, yaw_t_ns, yaw_rad)
    return CausalHeading(wrap_angle(sensor + told), _with_silence(std, track.t_ns, yaw_t_ns), spread)


def _refits(groups: int) -> list[int]:
    """After how many groups a causal offset is fitted."""
    counts: list[int] = []
    count = 1
    while count <= groups:
        counts.append(count)
        count += min(max(1, int(count * (REFIT_GROWTH - 1))), REFIT_GROUPS)
    return counts


def _differences(
    track: Track, yaw_t_ns: Int, yaw_rad: Float, tag_ahead_m: float, lag_s: Float
) -> tuple[CourseDifferences, Int]:
    """Course minus the yaw lag_s (T,) before, in groups wherever the motion tells, and when (N,) each is over."""
    speed, std = speed_of(track), np.maximum(course_std(track), MIN_COURSE_STD_RAD)
    seen_ns = track.t_ns - np.rint(lag_s * 1e9).astype(np.int64)
    use = (speed >= HOLD_BELOW_MPS) & (std <= 1 / TOLD_BY_STD)
    use &= (seen_ns >= yaw_t_ns[0]) & (track.t_ns <= yaw_t_ns[-1])
    if not use.any():
        return CourseDifferences(np.empty(0), np.empty(0), np.empty(0)), np.empty(0, dtype=np.int64)
    t_ns, seen_ns, weight = track.t_ns[use], seen_ns[use], std[use] ** -2
    # Of a late course the future is known as far as it is late; of a smoothed one, all.
    ahead_ns = np.where(lag_s[use] > 0, np.minimum(t_ns - seen_ns, RATE_NS), RATE_NS)
    swing = tag_ahead_m * _yaw_rate(seen_ns, ahead_ns, yaw_t_ns, yaw_rad) / speed[use]
    course = np.arctan2(track.velocity_mps[use, 1], track.velocity_mps[use, 0]) - np.arcsin(swing.clip(-1, 1))
    return _group(track, t_ns, course - interpolate_angle(seen_ns, yaw_t_ns, yaw_rad), weight)


def _tag_differences(track: Track, yaw_t_ns: Int, yaw_rad: Float, by_tags: TagsYaw) -> tuple[CourseDifferences, Int]:
    """The yaw of the tags minus the sensor's, in groups, and when (N,) each is over."""
    use = (by_tags.std_rad <= 1 / TOLD_BY_STD) & (track.t_ns >= yaw_t_ns[0]) & (track.t_ns <= yaw_t_ns[-1])
    if not use.any():
        return CourseDifferences(np.empty(0), np.empty(0), np.empty(0)), np.empty(0, dtype=np.int64)
    difference = by_tags.yaw_rad[use] - interpolate_angle(track.t_ns[use], yaw_t_ns, yaw_rad)
    return _group(track, track.t_ns[use], difference, np.maximum(by_tags.std_rad[use], MIN_COURSE_STD_RAD) ** -2)


def _group(track: Track, t_ns: Int, difference: Float, weight: Float) -> tuple[CourseDifferences, Int]:
    """Differences (M,) with their weights at t_ns (M,), in N groups, and when (N,) each is over."""
    cell, group = np.unique((t_ns - track.t_ns[0]) // GROUP_NS, return_inverse=True)
    count = np.bincount(group)
    east, north = (np.bincount(group, weight * each(difference)) for each in (np.cos, np.sin))
    t_s = np.bincount(group, seconds_since(t_ns, int(track.t_ns[0]))) / count
    grouped = CourseDifferences(t_s, np.arctan2(north, east), np.bincount(group, weight) / count)
    return grouped, track.t_ns[0] + (cell + 1) * GROUP_NS


def _yaw_rate(t_ns: Int, ahead_ns: Int, yaw_t_ns: Int, yaw_rad: Float) -> Float:
    """(N,) mean yaw rate from RATE_NS before each instant until ahead_ns (N,) after it."""
    behind_ns, end_ns = (np.clip(each, yaw_t_ns[0], yaw_t_ns[-1]) for each in (t_ns - RATE_NS, t_ns + ahead_ns))
    turned = wrap_angle(interpolate_angle(end_ns, yaw_t_ns, yaw_rad) - interpolate_angle(behind_ns, yaw_t_ns, yaw_rad))
    return turned / np.maximum((end_ns - behind_ns) * 1e-9, 1e-9)


def _with_silence(std_rad: Float, t_ns: Int, yaw_t_ns: Int) -> Float:
    """(T,) std at t_ns, grown with the time to the sensor's nearest yaw, as a held course's does."""
    after = np.searchsorted(yaw_t_ns, t_ns).clip(max=len(yaw_t_ns) - 1)
    nearest_ns = np.minimum(np.abs(yaw_t_ns[after] - t_ns), np.abs(t_ns - yaw_t_ns[(after - 1).clip(0)]))
    return np.minimum(np.hypot(std_rad, TURN_STD_RADPS * nearest_ns * 1e-9), UNKNOWN_YAW_STD_RAD)


GYRO_DRIFT = SensorDrift(rate_std_radps=0.02, walk_std=0.001)
"""Turn-on biases of consumer gyroscopes are about a degree a second, their noise a few hundredths per root second."""
CLEARLY_LESS = 0.5
"""A sign is taken for turned only where the fit then spreads by this much less: a straight walk hides it."""


@dataclass(frozen=True, slots=True)
class GyroHeading:
    """Yaw aligned to the course, and whether the IMU turned out to be mounted upside down."""

    heading: AlignedHeading
    upside_down: bool


def integrate_yaw_rate(t_ns: Int, rate_radps: Float) -> Float:
    """(M,) yaw since the first instant, not wrapped, from rates (M,) at increasing t_ns, by trapezoids."""
    t_s = seconds_since(t_ns, int(t_ns[0]) if len(t_ns) else 0)
    steps = np.diff(t_s) * (rate_radps[1:] + rate_radps[:-1]) / 2
    return np.concatenate([np.zeros(min(len(t_ns), 1)), np.cumsum(steps)])


def align_gyro(
    track: Track, t_ns: Int, rate_radps: Float, tag_ahead_m: float = 0.0, by_tags: TagsYaw | None = None
) -> GyroHeading:
    """align_yaw for the rate (M,) about the IMU's z axis, which may point up or down: offset, bias and sign are fitted.

    The std grows away from the motion as that of the bias says.
    """
    yaw_rad = integrate_yaw_rate(t_ns, rate_radps)
    up, down = (align_yaw(track, t_ns, sign * yaw_rad, tag_ahead_m, GYRO_DRIFT, by_tags) for sign in (1.0, -1.0))
    turned = down.spread_rad < CLEARLY_LESS * up.spread_rad
    return GyroHeading(down if turned else up, turned)


def align_gyro_causally(
    track: Track, t_ns: Int, rate_radps: Float, tag_ahead_m: float = 0.0, by_tags: TagsYaw | None = None
) -> CausalHeading:
    """align_gyro as it was known at each instant, the sign too."""
    yaw_rad = integrate_yaw_rate(t_ns, rate_radps)
    up, down = (
        align_yaw_causally(track, t_ns, sign * yaw_rad, tag_ahead_m, GYRO_DRIFT, by_tags) for sign in (1.0, -1.0)
    )
    turned = down.spread_rad < CLEARLY_LESS * up.spread_rad
    return CausalHeading(
        np.where(turned, down.yaw_rad, up.yaw_rad),
        np.where(turned, down.yaw_std_rad, up.yaw_std_rad),
        np.where(turned, down.spread_rad, up.spread_rad),
    )
