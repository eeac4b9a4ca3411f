"""Odometry as a second witness of how a tag moved: turned into map, weighed against the ranges' own track."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from quadlog.geometry import interpolate_angle, seconds_since, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.batch.factors import HOLD_S, Way, turned
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.tracking import Odometry
from quadlog.positioning.heading import ODOMETRY_DRIFT, UNKNOWN_YAW_STD_RAD, YawSensor, align_yaw

STANDING_MPS = 0.05
"""Below it odometry has no course of its own."""
LEG_S = 4.0
"""Way walked in so long is compared: long against the track's own errors, short against a log."""
LEAST_STD_MPS = 0.02
BELIEVED_SHARE = 0.5
"""Odometry that misses more of the way than this has no say at all."""
SLIP_STD = 3.0
"""A leg that odometry misses by more is a slip: there its std is what it missed by."""
UNTRIED_STD_MPS = 0.15
"""What a robot holds its odometry for while it knows no more of the log."""


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Odometry at M increasing instants: velocity_mps (M, 2) of base, in base; yaw_rad (M,) in the sensor's own frame.

    yaw_rate_radps: (M,) counter-clockwise. source: the sensor's name, for messages.
    """

    t_ns: Int
    velocity_mps: Float
    yaw_rad: Float
    yaw_rate_radps: Float
    source: str = "odometry"


def motion_between(
    t_ns: Int, position_m: Float, yaw_rad: Float, usable: np.ndarray, source: str, *, causal: bool
) -> BodyMotion | None:
    """Velocities between successive poses, at the middle of both, or at the second one if causal.

    N poses: position_m (N, 2), yaw_rad (N,) without steps of a turn; usable: (N-1,) bool. None with fewer than two.
    """
    first = np.flatnonzero(usable)
    if len(first) < 2:
        return None
    step_ns = np.diff(t_ns)[first]
    step_s = step_ns * 1e-9
    middle_rad = (yaw_rad[first] + yaw_rad[first + 1]) / 2
    x_mps, y_mps = (np.diff(position_m, axis=0)[first] / step_s[:, None]).T
    cos, sin = np.cos(middle_rad), np.sin(middle_rad)
    velocity_mps = np.stack([cos * x_mps + sin * y_mps, cos * y_mps - sin * x_mps], axis=1)
    yaw_rate_radps = np.diff(yaw_rad)[first] / step_s
    if causal:
        return BodyMotion(t_ns[first + 1], velocity_mps, yaw_rad[first + 1], yaw_rate_radps, source)
    return BodyMotion(t_ns[first] + step_ns // 2, velocity_mps, middle_rad, yaw_rate_radps, source)


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """An odometry in map, at its own M instants t_ns (M,), or the reason why it is not used.

    velocity_mps: (M, 2) of the tag; yaw_rad: (M,) of base, not wrapped. std_mps: (M,) of each axis of a second's mean
    velocity in base, without what the yaw adds: yaw_std_rad (M,). typical_std_mps: over the log. source: as in
    BodyMotion.
    """

    t_ns: Int
    velocity_mps: Float
    yaw_rad: Float
    std_mps: Float
    yaw_std_rad: Float
    typical_std_mps: float
    source: str
    reason: str | None = None


def measure_motion(motion: BodyMotion, track: Track, x_m: float, y_m: float, *, causal: bool) -> MeasuredMotion:
    """The motion of a tag at (x_m, y_m) in base, from odometry, with its std estimated from the log itself.

    track: of that tag from ranges alone, smoothed, or causal with causal=True; then nothing depends on what came later.
    Odometry's course is turned onto the track's, as a heading is. What odometry misses of the way in LEG_S is charged
    to odometry, but for the track's own errors (not of the causal one). So one that slips or has the wrong scale loses
    its say, and one that misses half of the way is refused (not the causal one, which could not know).
    """
    nothing = np.zeros((len(motion.t_ns), 2))
    refused = partial(MeasuredMotion, motion.t_ns, nothing, nothing[:, 0], nothing[:, 0], nothing[:, 0])
    if len(motion.t_ns) < 2 or len(track) < 2:
        return refused(np.inf, motion.source, "it or the track is too short")
    own_mps = _tag_velocity(motion, x_m, y_m)
    offset_rad, offset_std = _turn(motion, own_mps, track, causal=causal)
    map_mps = turned(offset_rad, own_mps)
    missed_m, way_m, own_way_m = _compare_legs(motion.t_ns, map_mps, track, causal=causal)
    compared = np.isfinite(missed_m)
    if not compared.any():
        return refused(np.inf, motion.source, f"it and the track never overlap for {LEG_S:.0f} s")
    missed, way = (float(np.median(each[compared])) for each in (missed_m, way_m))
    # Slips do not move the median, which of a squared Rayleigh variable is 2 ln 2 variances.
    usual, std = UNTRIED_STD_MPS, UNTRIED_STD_MPS
    if not causal:
        usual = float(missed / np.sqrt(2 * np.log(2) * LEG_S))
        track_m2 = float((np.trace(track.covariance_m2, axis1=1, axis2=2) / track.position_excess).mean())
        std = float(np.sqrt(max(usual**2 - track_m2 / LEG_S, LEAST_STD_MPS**2)))
        if missed > BELIEVED_SHARE * way:
            ratio = own_way_m[compared].sum() / max(float(way_m[compared].sum()), 1e-9)
            share = f"{100 * missed / max(way, 1e-9):.0f} %"
            return refused(
                std, motion.source, f"its motion is off by {share} of UWB's, its length {ratio:.2f} times UWB's"
            )
    per_leg_mps = missed_m / np.sqrt(2 * LEG_S)
    std_mps = np.where(per_leg_mps > SLIP_STD * max(usual, std), per_leg_mps, std)
    yaw_rad = np.unwrap(motion.yaw_rad) + np.unwrap(offset_rad)
    return MeasuredMotion(motion.t_ns, map_mps, yaw_rad, std_mps, offset_std, std, motion.source)


def _tag_velocity(motion: BodyMotion, x_m: float, y_m: float) -> Float:
    """(M, 2) of the tag, in the sensor's own frame: turning swings a tag that sits off the middle."""
    forward = motion.velocity_mps[:, 0] - motion.yaw_rate_radps * y_m
    left = motion.velocity_mps[:, 1] + motion.yaw_rate_radps * x_m
    return turned(motion.yaw_rad, np.stack([forward, left], axis=1))


def tag_odometry(motion: BodyMotion, measured: MeasuredMotion, start_ns: int, x_m: float, y_m: float) -> Odometry:
    """The tag's way in the sensor's own frame, by velocities, since its poses may jump; seconds since start_ns."""
    t_s = seconds_since(motion.t_ns, start_ns)
    way = Way(t_s, _summed(t_s, _tag_velocity(motion, x_m, y_m)), np.unwrap(motion.yaw_rad))
    return Odometry(way, measured.std_mps, in_map=False)


def odometry_in_map(motion: MeasuredMotion, start_ns: int) -> Odometry:
    """The way in map, with what its direction adds to the std."""
    t_s, speed_mps = seconds_since(motion.t_ns, start_ns), np.hypot(*motion.velocity_mps.T)
    way = Way(t_s, _summed(t_s, motion.velocity_mps), motion.yaw_rad)
    return Odometry(way, np.hypot(motion.std_mps, motion.yaw_std_rad * speed_mps), in_map=True)


def _summed(t_s: Float, velocity_mps: Float) -> Float:
    """(M, 2) the way since the first instant, by trapezoids."""
    steps_m = np.diff(t_s)[:, None] * (velocity_mps[1:] + velocity_mps[:-1]) / 2
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps_m, axis=0)])


def _turn(motion: BodyMotion, own_mps: Float, track: Track, *, causal: bool) -> tuple[Float, Float]:
    """Offset (M,) of the sensor's frame in map, and its std: that of odometry's course, so that no step is askew."""
    moving = np.hypot(own_mps[:, 0], own_mps[:, 1]) >= STANDING_MPS
    last = np.maximum.accumulate(np.where(moving, np.arange(len(moving)), -1))
    course = np.arctan2(own_mps[:, 1], own_mps[:, 0])[last.clip(0)]
    aligned = align_yaw(track, YawSensor(motion.t_ns, course, ODOMETRY_DRIFT), causal=causal)
    yaw_rad, std_rad = aligned.yaw_rad, aligned.yaw_std_rad
    at_track = wrap_angle(yaw_rad - interpolate_angle(track.t_ns, motion.t_ns, course))
    before = (np.searchsorted(track.t_ns, motion.t_ns, side="right") - 1).clip(0)
    if causal:
        known = motion.t_ns >= track.t_ns[0]
        return np.where(known, at_track[before], 0.0), np.where(known, std_rad[before], UNKNOWN_YAW_STD_RAD)
    return interpolate_angle(motion.t_ns, track.t_ns, at_track), std_rad[before]


def _compare_legs(t_ns: Int, map_mps: Float, track: Track, *, causal: bool) -> tuple[Float, Float, Float]:
    """(M,) how far odometry misses the track's way in LEG_S about each instant (causal: before it), and both ways.

    NaN where the track or odometry does not cover the leg.
    """
    start_ns = int(t_ns[0])
    t_s, track_s = seconds_since(t_ns, start_ns), seconds_since(track.t_ns, start_ns)
    summed_m = _summed(t_s, map_mps)
    ends_s = [t_s - (LEG_S if causal else LEG_S / 2), t_s + (0.0 if causal else LEG_S / 2)]
    covered = (ends_s[0] >= t_s[0]) & (ends_s[1] <= t_s[-1]) & _near(ends_s[0], track_s) & _near(ends_s[1], track_s)
    # From and to poses that were known then, so that a causal leg needs no later one.
    begin, end = (np.searchsorted(track_s, each, side="right").clip(1) - 1 for each in ends_s)
    own_m = np.stack(
        [np.interp(track_s[end], t_s, each) - np.interp(track_s[begin], t_s, each) for each in summed_m.T], axis=1
    )
    true_m = track.position_m[end] - track.position_m[begin]
    lengths = (np.hypot(*(own_m - true_m).T), np.hypot(*true_m.T), np.hypot(*own_m.T))
    missed_m, way_m, own_way_m = (np.where(covered, each, np.nan) for each in lengths)
    return missed_m, way_m, own_way_m


def _near(wanted_s: Float, known_s: Float) -> np.ndarray:
    """(M,) bool: something is known at or before each instant, not longer ago than HOLD_S."""
    before = np.searchsorted(known_s, wanted_s, side="right") - 1
    return (before >= 0) & (wanted_s - known_s[before.clip(0)] <= HOLD_S)
