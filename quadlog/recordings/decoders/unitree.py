"""States of Unitree's robots, ROS 1 and 2: joints, feet and IMU of LowState; odometry too of HighState, SportModeState.

Fields as in unitree_go and unitree_legged_msgs; quaternions are w, x, y, z. Without a header they have log time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Float, Imu, JointStates, Message, Odometry
from quadlog.recordings.decoders.columns import (
    WHOLE,
    Columns,
    InColumns,
    Ways,
    reachable_rows,
    stamps_ns,
    unit_rows,
)
from quadlog.recordings.decoders.joints import JointOrder, joint_states, motor_values
from quadlog.recordings.decoders.payload import nanoseconds, stamp_ns
from quadlog.recordings.decoders.pose import normalised, within_reach

FRAME = "odom"


def decode_low_state(message: Any, topic: str, order: JointOrder) -> tuple[Message, ...]:
    """unitree_go or unitree_legged_msgs LowState: joints and IMU."""
    return _joints(message, topic, order), _imu(message, stamp_ns(message))


def decode_high_state(message: Any, topic: str, order: JointOrder) -> tuple[Message, ...]:
    """unitree_legged_msgs HighState: odometry, IMU and, since unitree_legged_sdk 3.8, joints."""
    t_ns = stamp_ns(message)
    imu = _imu(message, t_ns)
    forward_mps, aside_mps = (float(each) for each in message.velocity[:2])
    linear_mps = np.array([forward_mps, aside_mps, 0.0])
    found: tuple[Message, ...] = _odometry(message, imu, linear_mps, topic), imu
    return (*found, _joints(message, topic, order)) if _has(message, "motorState", "motor_state") else found


def decode_sport_mode_state(message: Any, topic: str) -> tuple[Message, ...]:
    """unitree_go SportModeState: odometry and IMU. Its velocity is left out: its axes are undocumented."""
    t_ns = nanoseconds(int(message.stamp.sec), int(message.stamp.nanosec))
    imu = _imu(message, t_ns)
    return _odometry(message, imu, np.zeros(3), topic), imu


def _has(message: Any, *names: str) -> bool:
    return any(hasattr(message, name) for name in names)


def _field(message: Any, *names: str) -> Any:
    """The field by the first of its names that the message has. Raises AttributeError."""
    return getattr(message, next((name for name in names if hasattr(message, name)), names[-1]))


def _joints(message: Any, topic: str, order: JointOrder) -> JointStates:
    motors = _field(message, "motorState", "motor_state")
    values = [[each.q, each.dq, _field(each, "tauEst", "tau_est")] for each in motors]
    feet = np.asarray(_field(message, "footForce", "foot_force"), np.float64)
    tick = np.array([[getattr(message, "tick", np.nan)]], np.float64)
    row = motor_values(np.array(values, np.float64).reshape(1, -1, 3), feet[None], tick, topic, order)[0]
    return joint_states(stamp_ns(message), row)


def _imu(message: Any, t_ns: int | None) -> Imu:
    """Without orientation where the quaternion is all zeros or not finite."""
    state = _field(message, "imu_state", "imu")
    w, x, y, z = (float(each) for each in state.quaternion)
    absent = not np.isfinite([w, x, y, z]).all() or not any((w, x, y, z))
    rate_radps, acceleration_mps2 = (np.array(each, np.float64) for each in (state.gyroscope, state.accelerometer))
    return Imu(t_ns, "", None if absent else normalised((x, y, z, w), ""), rate_radps, acceleration_mps2)


def _odometry(message: Any, imu: Imu, linear_mps: Float, topic: str) -> Odometry:
    x_m, y_m, z_m = (float(each) for each in message.position)
    position_m = np.array(within_reach(x_m, y_m, z_m, topic))
    quat_xyzw = np.array([0.0, 0.0, 0.0, 1.0]) if imu.quat_xyzw is None else imu.quat_xyzw
    yaw_radps = float(_field(message, "yawSpeed", "yaw_speed"))
    angular_radps = np.array([*imu.angular_radps[:2], yaw_radps])
    return Odometry(imu.stamp_ns, FRAME, "", position_m, quat_xyzw, linear_mps, angular_radps)


_IMU_NUMBERS = 7


def _imu_of(name: str) -> dict[str, int]:
    return {f"{name}.quaternion": 4, f"{name}.gyroscope": 3}


def _motors_of(name: str, torque: str, feet: str) -> dict[str, int]:
    return {f"{name}.q": 1, f"{name}.dq": 1, f"{name}.{torque}": 1, feet: 4}


_LEGACY = _imu_of("imu") | _motors_of("motorState", "tauEst", "footForce")
_SNAKE = _imu_of("imu") | _motors_of("motor_state", "tau_est", "foot_force")
_GO = _imu_of("imu_state") | _motors_of("motor_state", "tau_est", "foot_force")
_TWIST = {"position": 3, "velocity": 3}
SPORT_MODE_STATE = {"stamp.sec": WHOLE, "stamp.nanosec": WHOLE} | _imu_of("imu_state") | {"position": 3, "yaw_speed": 1}


def low_state_ways(topic: str, order: JointOrder) -> Ways:
    """LowState by columns."""
    return [(wanted | {"tick": 1}, _low_states(topic, order)) for wanted in (_GO, _LEGACY, _SNAKE)]


def high_state_ways(topic: str, order: JointOrder) -> Ways:
    """HighState with motors by columns."""
    in_columns = _high_states(topic, order)
    return [(_LEGACY | _TWIST | {"yawSpeed": 1}, in_columns), (_SNAKE | _TWIST | {"yaw_speed": 1}, in_columns)]


def _low_states(topic: str, order: JointOrder) -> InColumns:
    def in_columns(_: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
        joints, imu = _joint_columns(numbers[:, :-1], numbers[:, -1:], topic, order), _imu_columns(None, numbers)
        return [*joints, imu], np.full(len(numbers), bool(joints))

    return in_columns


def _high_states(topic: str, order: JointOrder) -> InColumns:
    def in_columns(_: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
        state, position_m, velocity_mps = numbers[:, :-7], numbers[:, -7:-4], numbers[:, -4:-1]
        linear_mps = velocity_mps * (1.0, 1.0, 0.0)
        imu, joints = _imu_columns(None, state), _joint_columns(state, np.full((len(state), 1), np.nan), topic, order)
        odometry = _odometry_columns(imu, position_m, linear_mps, numbers[:, -1])
        return [odometry, imu, *joints], reachable_rows(position_m) & bool(joints)

    return in_columns


def sport_mode_states_in_columns(_: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    imu = _imu_columns(numbers[:, :2], numbers[:, 2:])
    position_m = numbers[:, 9:12]
    return [_odometry_columns(imu, position_m, np.zeros((len(numbers), 3)), numbers[:, 12]), imu], reachable_rows(
        position_m
    )


def _imu_columns(stamps: Float | None, numbers: Float) -> Columns:
    wxyz, rate_radps = numbers[:, :4], numbers[:, 4:_IMU_NUMBERS]
    quat_xyzw, finite = unit_rows(wxyz[:, [1, 2, 3, 0]])
    quat_xyzw[~finite | ~wxyz.any(axis=1)] = np.nan
    t_ns = None if stamps is None else stamps_ns(stamps)
    return Columns(Imu, t_ns, np.concatenate([rate_radps, quat_xyzw], axis=1))


def _joint_columns(numbers: Float, tick: Float, topic: str, order: JointOrder) -> list[Columns]:
    """None where the order does not fit: what is wrong is raised by the way through single messages."""
    motors, feet = numbers[:, _IMU_NUMBERS:-4].reshape(len(numbers), -1, 3), numbers[:, -4:]
    try:
        return [Columns(JointStates, None, motor_values(motors, feet, tick, topic, order))]
    except DecodeError:
        return []


def _odometry_columns(imu: Columns, position_m: Float, linear_mps: Float, yaw_radps: Float) -> Columns:
    quat_xyzw = np.where(np.isnan(imu.values[:, 3:]), (0.0, 0.0, 0.0, 1.0), imu.values[:, 3:])
    angular_radps = np.column_stack([imu.values[:, :2], yaw_radps])
    values = np.concatenate([position_m, quat_xyzw, linear_mps, angular_radps], axis=1)
    return Columns(Odometry, imu.stamp_ns, values, FRAME)
