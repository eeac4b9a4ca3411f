"""Simulated IMU with an arbitrary yaw offset, and simulated odometry that drifts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from quadlog.geometry import quat_from_euler, seconds_since
from quadlog.messages import GRAVITY_MPS2, Float, Imu, Int, Odometry
from quadlog.simulation.sensors.trajectory import Motion, Walk, turned_from_level

_TILT_STEP_S = 0.02


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """yaw_offset_rad turns the IMU's own frame against map; the rest are drifts and standard deviations."""

    yaw_offset_rad: float
    yaw_drift_radps: float = 0.0005
    yaw_std_rad: float = 0.002
    gyro_bias_radps: float = 0.002
    gyro_std_radps: float = 0.01
    acceleration_std_mps2: float = 0.1


# Steps of odometry are so many times too long, its headings drift, its twist is noisy.
SCALE, ODOMETRY_DRIFT_RADPS, SPEED_STD_MPS, YAW_RATE_STD_RADPS = 1.015, 0.003, 0.02, 0.01


def imu_messages(errors: ImuErrors, walk: Walk, start_ns: int, t_ns: Int, rng: np.random.Generator) -> Iterator[Imu]:
    """Readings at t_ns (N,) of an IMU in base."""
    t_s = seconds_since(t_ns, start_ns)
    motion = walk.at(t_s)
    yaw_rad = motion.yaw_rad + errors.yaw_offset_rad + errors.yaw_drift_radps * t_s
    yaw_rad = yaw_rad + rng.normal(0.0, errors.yaw_std_rad, len(t_s))
    quat_xyzw = quat_from_euler(yaw_rad, motion.pitch_rad, motion.roll_rad)
    inertial = getattr(walk, "inertial", None)
    true_radps, true_mps2 = inertial(t_s) if inertial else _inertial(walk, motion, t_s)
    biased_radps = true_radps + np.array([0.0, 0.0, errors.gyro_bias_radps])
    angular_radps = rng.normal(0.0, errors.gyro_std_radps, (len(t_s), 3)) + biased_radps
    linear_mps2 = rng.normal(0.0, errors.acceleration_std_mps2, (len(t_s), 3)) + true_mps2
    for index, stamp_ns in enumerate(t_ns):
        yield Imu(int(stamp_ns), "base", quat_xyzw[index], angular_radps[index], linear_mps2[index])


def _inertial(walk: Walk, motion: Motion, t_s: Float) -> tuple[Float, Float]:
    """See Walk, of a motion that says nothing of accelerations up and down; tilt rates are central differences."""
    before, after, zero = walk.at(t_s - _TILT_STEP_S), walk.at(t_s + _TILT_STEP_S), np.zeros(len(t_s))
    roll_radps = (after.roll_rad - before.roll_rad) / (2 * _TILT_STEP_S)
    pitch_radps = (after.pitch_rad - before.pitch_rad) / (2 * _TILT_STEP_S)
    about_z = turned_from_level(motion, np.column_stack([zero, zero, motion.yaw_rate_radps]))
    # Pitch turns about the y axis between yaw and roll, roll about the body's own x axis.
    about_y = turned_from_level(motion, np.column_stack([zero, pitch_radps, zero]))
    true_radps = about_z + about_y + np.column_stack([roll_radps, zero, zero])
    sideways_mps2 = motion.speed_mps * motion.yaw_rate_radps
    force_mps2 = np.column_stack([motion.acceleration_mps2, sideways_mps2, np.full(len(t_s), GRAVITY_MPS2)])
    return true_radps, turned_from_level(motion, force_mps2)


def odometry_messages(walk: Walk, start_ns: int, t_ns: Int, rng: np.random.Generator) -> Iterator[Odometry]:
    """Poses at t_ns (N,) in odom, which is base at the first of them, summed up from noisy steps over a flat floor."""
    t_s = seconds_since(t_ns, start_ns)
    motion = walk.at(t_s)
    step_s = np.diff(t_s, prepend=t_s[0])
    speed_mps = SCALE * motion.speed_mps + rng.normal(0.0, SPEED_STD_MPS, len(t_s))
    yaw_rate_radps = motion.yaw_rate_radps + ODOMETRY_DRIFT_RADPS
    yaw_rate_radps = yaw_rate_radps + rng.normal(0.0, YAW_RATE_STD_RADPS, len(t_s))
    yaw_rad = np.cumsum(yaw_rate_radps * step_s)
    # A step goes along the heading halfway through it.
    middle_rad = yaw_rad - yaw_rate_radps * step_s / 2
    position_m = np.cumsum((speed_mps * step_s)[:, None] * _unit(middle_rad), axis=0)
    quat_xyzw = quat_from_euler(yaw_rad)
    for index, stamp_ns in enumerate(t_ns):
        yield Odometry(
            stamp_ns=int(stamp_ns),
            frame_id="odom",
            child_frame_id="base",
            position_m=np.append(position_m[index], 0.0),
            quat_xyzw=quat_xyzw[index],
            linear_mps=np.array([speed_mps[index], 0.0, 0.0]),
            angular_radps=np.array([0.0, 0.0, yaw_rate_radps[index]]),
        )


def _unit(angle_rad: Float) -> Float:
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
