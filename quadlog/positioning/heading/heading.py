"""Yaw in map: that of another sensor, turned onto the course of the track, with its uncertainty.

One tag gives no heading. While its carrier walks forward, the course does;
one degree of error moves an obstacle 10 m away by 17 cm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import interpolate_angle, seconds_since, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.heading.yaw_offset import (
    GROUP_NS,
    UNKNOWN_YAW_STD_RAD,
    CourseDifferences,
    SensorDrift,
    YawOffset,
    fit_offset,
)

HOLD_BELOW_MPS = 0.2
TURN_STD_RADPS = 0.5
"""A yaw that is only held is off by so much after a second, by twice that after two: walkers turn on the spot."""
LONGEST_LAG_S = 2.0


def course_heading(
    track: Track, before_motion_rad: float | None = None, lag_s: Float | float = 0.0
) -> tuple[Float, Float]:
    """(T,) yaw along the velocity, held where the speed is below HOLD_BELOW_MPS, and its std (T,).

    Before the first motion: before_motion_rad, which a causal track must give, since the first course lies in its
    future; None takes that first course. A track that never moves has yaw zero, or before_motion_rad.
    The std, for a carrier that looks where it walks, is that of the velocity across the course over the speed. While
    held it grows by TURN_STD_RADPS times the time since; so it does by lag_s, (T,) or one, by which the velocity is
    late. A before_motion_rad is worth nothing.
    """
    moving = speed_of(track) >= HOLD_BELOW_MPS
    source = np.maximum.accumulate(np.where(moving, np.arange(len(track)), -1))
    if before_motion_rad is None and moving.any():
        source = np.where(source >= 0, source, np.argmax(moving))
    source, known = source.clip(0), source >= 0
    course = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0])[source]
    held_s = np.abs(track.t_ns - track.t_ns[source]) * 1e-9 + lag_s
    std = np.minimum(np.hypot(course_std(track)[source], TURN_STD_RADPS * held_s), UNKNOWN_YAW_STD_RAD)
    yaw_rad = wrap_angle(np.where(known, course, before_motion_rad or 0.0))
    return yaw_rad, np.where(known, std, UNKNOWN_YAW_STD_RAD)


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
GYRO_DRIFT = SensorDrift(rate_std_radps=0.02, walk_std=0.001)
"""Turn-on biases of consumer gyroscopes are about a degree a second, their noise a few hundredths per root second."""
CLEARLY_LESS = 0.5
"""A sign is taken for turned only where the fit then spreads by this much less: a straight walk hides it."""
REFIT_GROWTH = 1.05
REFIT_GROUPS = 50
"""A causal offset is fitted again when its groups have grown by 5 %, or by ten seconds of motion."""


@dataclass(frozen=True, slots=True)
class YawSensor:
    """Yaw (M,) at increasing t_ns (M,) in a frame of the sensor's own, and how it drifts.

    either_way: whether the sensor may be mounted upside down, so that its turns count the other way round.
    """

    t_ns: Int
    yaw_rad: Float
    drift: SensorDrift = NO_DRIFT
    either_way: bool = False


def gyro_sensor(t_ns: Int, rate_radps: Float) -> YawSensor:
    """The yaw since the first instant, by trapezoids, of a rate (M,) about an IMU's z axis, which may point down."""
    t_s = seconds_since(t_ns, int(t_ns[0]) if len(t_ns) else 0)
    steps = np.diff(t_s) * (rate_radps[1:] + rate_radps[:-1]) / 2
    return YawSensor(t_ns, np.concatenate([np.zeros(min(len(t_ns), 1)), np.cumsum(steps)]), GYRO_DRIFT, True)


@dataclass(frozen=True, slots=True)
class TagsYaw:
    """Yaw (T,) of base at a track's instants from the lever arms of several tags, and its std (T,).

    constant_std_rad: the part of the std that is the same error all along.
    """

    yaw_rad: Float
    std_rad: Float
    constant_std_rad: float


@dataclass(frozen=True, slots=True)
class AlignedHeading:
    """Yaw in map at the track's T instants, in [-pi, pi), and its std, at most UNKNOWN_YAW_STD_RAD.

    spread_rad: (T,) median absolute difference of the course from it; infinite where the course did not show how the
    sensor is turned. fit: the offset, of a causal heading the last one; None where the track never moved while the
    sensor gave yaw, and of a causal heading that was never known. upside_down: whether its turns count the other way.
    """

    yaw_rad: Float
    yaw_std_rad: Float
    spread_rad: Float
    fit: YawOffset | None = None
    upside_down: bool = False

    @property
    def is_known(self) -> np.ndarray:
        """(T,) bool, whether it was known how the sensor is turned."""
        return np.isfinite(self.spread_rad)


def align_yaw(
    track: Track, sensor: YawSensor, tag_ahead_m: float = 0.0, by_tags: TagsYaw | None = None, *, causal: bool = False
) -> AlignedHeading:
    """Turn a sensor's yaw by the offset that fits the track's course best.

    The offset is constant, or for a sensor with a drift rate a line in time; see fit_offset. It is fitted to course
    minus yaw over moving instants where the sensor was on, weighted with one over the course's variance. A tag that
    sits tag_ahead_m in front of base swings out in turns, by arcsin(yaw rate x tag_ahead_m / speed), which is taken
    out. Where nothing moved, or course and yaw have nothing in common, the std is that of an unknown direction.
    by_tags: takes the place of the course, also at rest. causal: at each instant the fit to what was known then, again
    whenever there is REFIT_GROWTH as much of it.
    """
    if sensor.either_way:
        signed = (replace(sensor, yaw_rad=sign * sensor.yaw_rad, either_way=False) for sign in (1.0, -1.0))
        up, down = (align_yaw(track, each, tag_ahead_m, by_tags, causal=causal) for each in signed)
        turned = down.spread_rad < CLEARLY_LESS * up.spread_rad
        names, upside_down = ("yaw_rad", "yaw_std_rad", "spread_rad"), bool(turned[-1:].any())
        yaw_rad, std, spread = (np.where(turned, getattr(down, name), getattr(up, name)) for name in names)
        return AlignedHeading(yaw_rad, std, spread, (down if upside_down else up).fit, upside_down)
    fit: YawOffset | None = None
    n = len(track)
    offset, std, spread = np.zeros(n), np.full(n, UNKNOWN_YAW_STD_RAD), np.full(n, np.inf)
    if n == 0 or len(sensor.t_ns) == 0:
        return AlignedHeading(offset, std, spread)
    lag_s = filter_lag_s(track) if causal and by_tags is None else np.zeros(n)
    differences, over_ns = _differences(track, sensor, tag_ahead_m, by_tags, lag_s)
    counts = _refits(len(over_ns)) if causal else [len(over_ns)] * (len(over_ns) > 0)
    t_s, constant_std = seconds_since(track.t_ns, int(track.t_ns[0])), by_tags.constant_std_rad if by_tags else 0.0
    since = [int(np.searchsorted(track.t_ns, over_ns[count - 1])) if causal else 0 for count in counts]
    for count, begin, end in zip(counts, since, [*since, n][1:], strict=True):
        fit = fit_offset(differences.until(count), sensor.drift)
        if fit.agrees or causal:
            offset[begin:end] = fit.at(t_s[begin:end])
        if fit.agrees:
            std[begin:end], spread[begin:end] = np.hypot(fit.std_at(t_s[begin:end]), constant_std), fit.spread_rad
    if causal and not np.isfinite(spread).any():
        fit = None
    yaw_rad = wrap_angle(interpolate_angle(track.t_ns, sensor.t_ns, sensor.yaw_rad) + offset)
    return AlignedHeading(yaw_rad, _with_silence(std, track.t_ns, sensor.t_ns), spread, fit)


def _refits(groups: int) -> list[int]:
    """After how many groups a causal offset is fitted."""
    counts: list[int] = []
    count = 1
    while count <= groups:
        counts.append(count)
        count += min(max(1, int(count * (REFIT_GROWTH - 1))), REFIT_GROUPS)
    return counts


def _differences(
    track: Track, sensor: YawSensor, tag_ahead_m: float, by_tags: TagsYaw | None, lag_s: Float
) -> tuple[CourseDifferences, Int]:
    """Course, or yaw of the tags, minus the sensor's yaw lag_s (T,) before, in N groups, and when (N,) each is over."""
    seen_ns, speed = track.t_ns - np.rint(lag_s * 1e9).astype(np.int64), speed_of(track)
    if by_tags is None:
        yaw_rad, std = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0]), course_std(track)
    else:
        yaw_rad, std = by_tags.yaw_rad, by_tags.std_rad
    use = (std <= 1 / TOLD_BY_STD) & (seen_ns >= sensor.t_ns[0]) & (track.t_ns <= sensor.t_ns[-1])
    if by_tags is None:
        use &= speed >= HOLD_BELOW_MPS
    t_ns, seen_ns, difference = track.t_ns[use], seen_ns[use], yaw_rad[use]
    weight = np.maximum(std[use], MIN_COURSE_STD_RAD) ** -2
    if by_tags is None:
        # Of a late course the future is known as far as it is late; of a smoothed one, all.
        ahead_ns = np.where(lag_s[use] > 0, np.minimum(t_ns - seen_ns, RATE_NS), RATE_NS)
        swing = tag_ahead_m * _yaw_rate(seen_ns, ahead_ns, sensor) / speed[use]
        difference = difference - np.arcsin(swing.clip(-1, 1))
    difference = difference - interpolate_angle(seen_ns, sensor.t_ns, sensor.yaw_rad)
    cell, group = np.unique((t_ns - track.t_ns[0]) // GROUP_NS, return_inverse=True)
    count = np.bincount(group)
    east, north = (np.bincount(group, weight * each(difference)) for each in (np.cos, np.sin))
    t_s = np.bincount(group, seconds_since(t_ns, int(track.t_ns[0]))) / count
    grouped = CourseDifferences(t_s, np.arctan2(north, east), np.bincount(group, weight) / count)
    return grouped, track.t_ns[0] + (cell + 1) * GROUP_NS


def _yaw_rate(t_ns: Int, ahead_ns: Int, sensor: YawSensor) -> Float:
    """(N,) mean yaw rate from RATE_NS before each instant until ahead_ns (N,) after it."""
    ends_ns = (np.clip(each, sensor.t_ns[0], sensor.t_ns[-1]) for each in (t_ns - RATE_NS, t_ns + ahead_ns))
    behind_ns, end_ns = ends_ns
    first, last = (interpolate_angle(each, sensor.t_ns, sensor.yaw_rad) for each in (behind_ns, end_ns))
    return wrap_angle(last - first) / np.maximum((end_ns - behind_ns) * 1e-9, 1e-9)


def _with_silence(std_rad: Float, t_ns: Int, yaw_t_ns: Int) -> Float:
    """(T,) std at t_ns, grown with the time to the sensor's nearest yaw, as a held course's does."""
    after = np.searchsorted(yaw_t_ns, t_ns).clip(max=len(yaw_t_ns) - 1)
    nearest_ns = np.minimum(np.abs(yaw_t_ns[after] - t_ns), np.abs(t_ns - yaw_t_ns[(after - 1).clip(0)]))
    return np.minimum(np.hypot(std_rad, TURN_STD_RADPS * nearest_ns * 1e-9), UNKNOWN_YAW_STD_RAD)
