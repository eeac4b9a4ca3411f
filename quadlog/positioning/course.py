"""The course of a track: the yaw of a carrier that walks forward, its std, and how late it is."""

from __future__ import annotations

import numpy as np

from quadlog.geometry import wrap_angle
from quadlog.messages import Float
from quadlog.positioning.tracker import Track
from quadlog.positioning.yaw_fit import UNKNOWN_YAW_STD_RAD

HOLD_BELOW_MPS = 0.2
TURN_STD_RADPS = 0.5
"""A yaw that is only held is off by so much after a second, by twice that after two: walkers turn on the spot."""
LONGEST_LAG_S = 2.0


def course_heading(
    track: Track, hold_below_mps: float = HOLD_BELOW_MPS, before_motion_rad: float | None = None
) -> Float:
    """(T,) yaw along the velocity, held where the speed is below hold_below_mps.

    Before the first motion: before_motion_rad, which a causal track must give,
    since the first course lies in its future; None takes that first course.
    A track that never moves has yaw zero, or before_motion_rad.
    """
    moving = speed_of(track) >= hold_below_mps
    course = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0])
    last_moving = np.maximum.accumulate(np.where(moving, np.arange(len(track)), -1))
    first = 0.0 if before_motion_rad is None else before_motion_rad
    if before_motion_rad is None and moving.any():
        first = float(course[np.argmax(moving)])
    return wrap_angle(np.where(last_moving >= 0, course[last_moving.clip(0)], first))


def course_heading_std(
    track: Track,
    hold_below_mps: float = HOLD_BELOW_MPS,
    before_motion_rad: float | None = None,
    lag_s: Float | float = 0.0,
) -> Float:
    """(T,) std of course_heading with the same arguments, for a carrier that looks where it walks.

    That of the velocity across the course over the speed. While held it grows
    by TURN_STD_RADPS times the time since; so it does by lag_s, (T,) or one, by
    which the velocity is late. A before_motion_rad is worth nothing.
    """
    if len(track) == 0:
        return np.empty(0)
    moving = speed_of(track) >= hold_below_mps
    index = np.arange(len(track))
    source = np.maximum.accumulate(np.where(moving, index, -1))
    known = source >= 0
    if before_motion_rad is None and moving.any():
        source, known = np.where(known, source, np.argmax(moving)), np.ones(len(track), dtype=np.bool_)
    source = source.clip(0)
    held_s = np.abs(track.t_ns - track.t_ns[source]) * 1e-9 + lag_s
    std = np.hypot(course_std(track)[source], TURN_STD_RADPS * held_s)
    return np.where(known, np.minimum(std, UNKNOWN_YAW_STD_RAD), UNKNOWN_YAW_STD_RAD)


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
