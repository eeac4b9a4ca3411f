"""Yaw in map: the course of the track, or the yaw of another sensor turned onto it.

One tag gives no heading. While its carrier walks forward, the course does;
one degree of error moves an obstacle 10 m away by 17 cm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import interpolate_angle, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.tracker import Track

HOLD_BELOW_MPS = 0.2
BLOCK_NS = 1_000_000_000
"""Course errors persist over strides: each second of motion counts once in the offset's std."""


@dataclass(frozen=True, slots=True)
class AlignedHeading:
    """Yaw in map at the track's T instants, and how it was had.

    yaw_rad: (T,) in [-pi, pi); offset_rad: added to the sensor's yaw; std_rad: of the offset,
    infinite where the track never moved while the sensor gave yaw; moving_s: seconds of motion it rests on.
    """

    yaw_rad: Float
    offset_rad: float
    std_rad: float
    moving_s: float


def course_heading(
    track: Track, hold_below_mps: float = HOLD_BELOW_MPS, before_motion_rad: float | None = None
) -> Float:
    """(T,) yaw along the velocity, held where the speed is below hold_below_mps.

    Before the first motion: before_motion_rad, which a causal track must give,
    since the first course lies in its future; None takes that first course.
    A track that never moves has yaw zero, or before_motion_rad.
    """
    moving = _speed(track) >= hold_below_mps
    course = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0])
    last_moving = np.maximum.accumulate(np.where(moving, np.arange(len(track)), -1))
    first = 0.0 if before_motion_rad is None else before_motion_rad
    if before_motion_rad is None and moving.any():
        first = float(course[np.argmax(moving)])
    return wrap_angle(np.where(last_moving >= 0, course[last_moving.clip(0)], first))


def align_yaw(
    track: Track, yaw_t_ns: Int, yaw_rad: Float, tag_ahead_m: float = 0.0, hold_below_mps: float = HOLD_BELOW_MPS
) -> AlignedHeading:
    """Turn a sensor's yaw (M,) at increasing yaw_t_ns by the constant offset that fits the track's course best.

    The offset is a circular mean of course minus yaw over moving instants where
    the sensor was on, weighted with the squared speed, since a course's variance
    falls with it. Starting at the best of 36 directions and letting the weights
    fall with the residual, sideways or backward steps in the minority do not
    count. A tag that sits tag_ahead_m in front of base swings out in turns, by
    arcsin(yaw rate x tag_ahead_m / speed), which is taken out. Where nothing
    moved the offset is zero and its std infinite.
    """
    if len(yaw_t_ns) == 0:
        return AlignedHeading(np.zeros(len(track)), 0.0, np.inf, 0.0)
    sensor = interpolate_angle(track.t_ns, yaw_t_ns, yaw_rad)
    speed = _speed(track)
    use = (speed >= hold_below_mps) & (track.t_ns >= yaw_t_ns[0]) & (track.t_ns <= yaw_t_ns[-1])
    if not use.any():
        return AlignedHeading(sensor, 0.0, np.inf, 0.0)
    course = np.arctan2(track.velocity_mps[use, 1], track.velocity_mps[use, 0])
    swing = tag_ahead_m * _yaw_rate(track.t_ns[use], yaw_t_ns, yaw_rad) / speed[use]
    difference, weight = wrap_angle(course - np.arcsin(swing.clip(-1, 1)) - sensor[use]), speed[use] ** 2

    offset = _best_direction(difference, weight)
    residual = wrap_angle(difference - offset)
    scale = 1.0
    for _ in range(50):
        scale = 2 * max(float(np.median(np.abs(residual))), 1e-6)
        step = float(np.average(residual, weights=weight / (1 + (residual / scale) ** 2)))
        offset, residual = offset + step, wrap_angle(residual - step)
        if abs(step) < 1e-6:
            break
    std, moving_s = _std_of_offset(residual, weight, scale, track.t_ns[use])
    return AlignedHeading(wrap_angle(sensor + offset), float(wrap_angle(np.asarray(offset))), std, moving_s)


def align_yaw_causally(track: Track, yaw_t_ns: Int, yaw_rad: Float, hold_below_mps: float = HOLD_BELOW_MPS) -> Float:
    """(T,) the sensor's yaw (M,) turned by what the course has told until each instant, by nothing before.

    The running circular mean of course minus yaw, weighted as in align_yaw,
    but with no second look: what a robot could have known then.
    """
    if len(yaw_t_ns) == 0:
        return np.zeros(len(track))
    sensor = interpolate_angle(track.t_ns, yaw_t_ns, yaw_rad)
    speed = _speed(track)
    moving = (speed >= hold_below_mps) & (track.t_ns >= yaw_t_ns[0]) & (track.t_ns <= yaw_t_ns[-1])
    course = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0])
    told = np.cumsum(np.where(moving, speed**2, 0.0) * np.exp(1j * (course - sensor)))
    return wrap_angle(sensor + np.angle(told))


def _speed(track: Track) -> Float:
    speed: Float = np.hypot(track.velocity_mps[:, 0], track.velocity_mps[:, 1])
    return speed


def _best_direction(difference_rad: Float, weight: Float) -> float:
    """The direction, of 36, with the least weighted sum of absolute differences."""
    directions = np.arange(36) * (2 * np.pi / 36)
    cost = [float(np.sum(weight * np.abs(wrap_angle(difference_rad - each)))) for each in directions]
    return float(directions[int(np.argmin(cost))])


def _yaw_rate(t_ns: Int, yaw_t_ns: Int, yaw_rad: Float) -> Float:
    """(N,) mean yaw rate over half a second about each instant, which is as sharp as a track is."""
    behind_ns, ahead_ns = (np.clip(t_ns + side, yaw_t_ns[0], yaw_t_ns[-1]) for side in (-BLOCK_NS // 4, BLOCK_NS // 4))
    turned = wrap_angle(
        interpolate_angle(ahead_ns, yaw_t_ns, yaw_rad) - interpolate_angle(behind_ns, yaw_t_ns, yaw_rad)
    )
    return turned / np.maximum((ahead_ns - behind_ns) * 1e-9, 1e-9)


def _std_of_offset(residual_rad: Float, weight: Float, scale_rad: float, t_ns: Int) -> tuple[float, float]:
    """Std of the robust mean from the scatter of one-second blocks, and the number of blocks, in seconds.

    The mean solves sum w psi(r) = 0 with psi = r / (1 + u^2), u = r/scale; its
    variance is sum (w psi)^2 / (sum w psi')^2. One block shows no scatter: the
    rms of its residuals stands for the std.
    """
    _, block = np.unique((t_ns - t_ns[0]) // BLOCK_NS, return_inverse=True)
    n = int(block.max()) + 1
    if n == 1:
        return float(np.sqrt(np.average(residual_rad**2, weights=weight))), 1.0
    u2 = (residual_rad / scale_rad) ** 2
    pull = np.bincount(block, weight * residual_rad / (1 + u2), n)
    # Residuals all over the circle make psi' cancel: the floor keeps the std finite, and large.
    slope = max(float(np.sum(weight * (1 - u2) / (1 + u2) ** 2)), 0.1 * float(np.sum(weight / (1 + u2))))
    return float(np.sqrt(np.sum(pull**2) * n / (n - 1)) / slope), float(n)
