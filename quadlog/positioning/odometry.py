"""Odometry as a second witness of how a tag moved: turned into map, weighed against the ranges' own track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import interpolate_angle, seconds_since, turned, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.batch.factors import HOLD_S, Way
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.tracking import Odometry
from quadlog.positioning.heading import ODOMETRY_DRIFT, UNKNOWN_YAW_STD_RAD, YawSensor, align_yaw, summed

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
    step_ns, step_s = np.diff(t_ns)[first], np.diff(t_ns)[first] * 1e-9
    middle_rad = (yaw_rad[first] + yaw_rad[first + 1]) / 2
    velocity_mps = turned(-middle_rad, np.diff(position_m, axis=0)[first] / step_s[:, None])
    yaw_rate_radps = np.diff(yaw_rad)[first] / step_s
    if causal:
        return BodyMotion(t_ns[first + 1], velocity_mps, yaw_rad[first + 1], yaw_rate_radps, source)
    return BodyMotion(t_ns[first] + step_ns // 2, velocity_mps, middle_rad, yaw_rate_radps, source)


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """An odometry as a track takes it, or the reason why it does not.

    yaw_rad: (M,) of base in map at its instants, not wrapped. typical_std_mps: over the log, of each axis of a second's
    mean velocity. source: as in BodyMotion.
    """

    odometry: Odometry | None
    yaw_rad: Float
    typical_std_mps: float
    source: str
    reason: str = ""


def measure_motion(
    motion: BodyMotion, track: Track, place_m: tuple[float, float], start_ns: int, *, causal: bool
) -> MeasuredMotion:
    """The way of a tag at place_m in base, by odometry, with its std estimated from the log itself; s since start_ns.

    track: of that tag from ranges alone, smoothed, or causal with causal=True; then nothing depends on what came later.
    Odometry's course is turned onto the track's, as a heading is. What odometry misses of the way in LEG_S is charged
    to odometry, but for the track's own errors. So one that slips or has the wrong scale loses its say, and one that
    misses half of the way is refused (not the causal one, which could not know). Smoothed, the way is in the sensor's
    own frame, by velocities, since its poses may jump; causal in map, its std with what its direction adds.
    """

    def refused(std_mps: float, reason: str) -> MeasuredMotion:
        return MeasuredMotion(None, np.empty(0), std_mps, motion.source, reason)

    if len(motion.t_ns) < 2 or len(track) < 2:
        return refused(np.inf, "it or the track is too short")
    # Turning swings a tag that sits off the middle.
    swing_mps = np.outer(motion.yaw_rate_radps, [-place_m[1], place_m[0]])
    t_s, own_mps = seconds_since(motion.t_ns, start_ns), turned(motion.yaw_rad, motion.velocity_mps + swing_mps)
    offset_rad, offset_std = _turn(motion, own_mps, track, causal=causal)
    map_mps = turned(offset_rad, own_mps)
    missed_m, way_m, own_way_m = _compare_legs(t_s, map_mps, seconds_since(track.t_ns, start_ns), track, causal=causal)
    compared = np.isfinite(missed_m)
    if not compared.any():
        return refused(np.inf, f"it and the track never overlap for {LEG_S:.0f} s")
    leg_mps = missed_m / np.sqrt(2 * LEG_S)
    usual = std = _usual_so_far(t_s, leg_mps) if causal else np.zeros(1)
    if not causal:
        missed, way = (max(float(np.median(each[compared])), 1e-9) for each in (missed_m, way_m))
        # Slips do not move the median, which of a squared Rayleigh variable is 2 ln 2 variances.
        usual = np.array([missed / np.sqrt(2 * np.log(2) * LEG_S)])
        track_m2 = float((np.trace(track.covariance_m2, axis1=1, axis2=2) / track.position_excess).mean())
        std = np.sqrt(np.maximum(usual**2 - track_m2 / LEG_S, LEAST_STD_MPS**2))
        if missed > BELIEVED_SHARE * way:
            ratio = own_way_m[compared].sum() / max(float(way_m[compared].sum()), 1e-9)
            share = f"its motion is off by {100 * missed / way:.0f} % of UWB's"
            return refused(float(std[0]), f"{share}, its length {ratio:.2f} times UWB's")
    yaw_rad = np.unwrap(motion.yaw_rad)
    std_mps = np.where(leg_mps > SLIP_STD * np.maximum(usual, std), leg_mps, std)
    map_rad = yaw_rad + np.unwrap(offset_rad)
    if causal:
        std_mps = np.hypot(std_mps, offset_std * np.hypot(*map_mps.T))
        odometry = Odometry(Way(t_s, summed(t_s, map_mps), map_rad), std_mps, in_map=True)
    else:
        odometry = Odometry(Way(t_s, summed(t_s, own_mps), yaw_rad), std_mps, in_map=False)
    return MeasuredMotion(odometry, map_rad, float(std[-1]), motion.source)


def _usual_so_far(t_s: Float, leg_mps: Float) -> Float:
    """(M,) the median of the legs that were compared by then, M with NaN; UNTRIED_STD_MPS counts as one leg."""
    usual_mps, tried = np.full(len(t_s), UNTRIED_STD_MPS), np.flatnonzero(np.isfinite(leg_mps))
    if len(tried):
        number = ((t_s - t_s[tried[0]]) / LEG_S).astype(np.int64) + (t_s >= t_s[tried[0]])
        for n in range(2, int(number.max()) + 1):
            so_far = leg_mps[tried[number[tried] < n]] / np.sqrt(np.log(2))
            median_mps = max(float(np.median(so_far)), LEAST_STD_MPS)
            usual_mps[number == n] = median_mps ** (1 - 1 / n) * UNTRIED_STD_MPS ** (1 / n)
    return usual_mps


def _turn(motion: BodyMotion, own_mps: Float, track: Track, *, causal: bool) -> tuple[Float, Float]:
    """Offset (M,) of the sensor's frame in map, and its std: that of odometry's course, so that no step is askew."""
    moving = np.hypot(*own_mps.T) >= STANDING_MPS
    last = np.maximum.accumulate(np.where(moving, np.arange(len(moving)), -1))
    course = np.arctan2(own_mps[:, 1], own_mps[:, 0])[last.clip(0)]
    aligned = align_yaw(track, YawSensor(motion.t_ns, course, ODOMETRY_DRIFT), causal=causal)
    at_track = wrap_angle(aligned.yaw_rad - interpolate_angle(track.t_ns, motion.t_ns, course))
    before = (np.searchsorted(track.t_ns, motion.t_ns, side="right") - 1).clip(0)
    if causal:
        known = motion.t_ns >= track.t_ns[0]
        return np.where(known, at_track[before], 0.0), np.where(known, aligned.yaw_std_rad[before], UNKNOWN_YAW_STD_RAD)
    return interpolate_angle(motion.t_ns, track.t_ns, at_track), aligned.yaw_std_rad[before]


def _compare_legs(
    t_s: Float, map_mps: Float, track_s: Float, track: Track, *, causal: bool
) -> tuple[Float, Float, Float]:
    """(M,) how far odometry misses the track's way in LEG_S about (causal: before) an instant, and both; or NaN."""
    summed_m, begin_s = summed(t_s, map_mps), t_s - (LEG_S if causal else LEG_S / 2)
    covered, ends = (begin_s >= t_s[0]) & (begin_s + LEG_S <= t_s[-1] + 1e-9), []
    for end_s in (begin_s, begin_s + LEG_S):
        # From and to poses that were known then, so that a causal leg needs no later one.
        at = np.searchsorted(track_s, end_s, side="right") - 1
        covered &= (at >= 0) & (end_s - track_s[at] <= HOLD_S)
        ends.append(at.clip(0))
    (begin, end), blank = ends, np.where(covered, 0.0, np.nan)
    own_m = np.column_stack([np.diff(np.interp(track_s[[begin, end]], t_s, each), axis=0)[0] for each in summed_m.T])
    true_m = track.position_m[end] - track.position_m[begin]
    missed_m, way_m, own_way_m = (np.hypot(*each.T) + blank for each in (own_m - true_m, true_m, own_m))
    return missed_m, way_m, own_way_m
