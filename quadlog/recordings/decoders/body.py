"""Joints, feet, IMU and odometry of quadrupeds: JointState, and the states of the robots of Unitree, ROS 1 and 2.

Fields as in unitree_go and unitree_legged_msgs; quaternions are w, x, y, z. Without a header they have log time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from quadlog.messages import TICKS, Imu, JointStates, Odometry
from quadlog.recordings.decoders.fields import Columns
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.poses import sound_position_m
from quadlog.recordings.decoders.rows import HEADER, NO_TURN, Part, Type, part, unit_rows

JOINT_VALUES = ("position_rad", "velocity_radps", "torque_nm")


def joint_state(columns: Columns, order: JointOrder) -> Iterator[Part]:
    """Raises DecodeError for lists of different lengths, UnknownJoints without legs."""
    names, lists = columns["names"], dict(zip(("positions", "velocities", "efforts"), JOINT_VALUES, strict=True))
    for what, name in lists.items():
        if columns[name].shape[1] not in (0, len(names)):
            raise ValueError(f"names {len(names)} joints, but has {columns[name].shape[1]} {what}")
    found = order.of_names(names, columns.topic)
    values: dict[str, Any] = {
        name: columns[name][:, found.place] * found.sign if columns[name].shape[1] else np.nan
        for name in lists.values()
    }
    forces = found.feet is not None and columns["torque_nm"].shape[1]
    feet = columns["torque_nm"][:, found.feet] if forces else np.nan
    yield part(JointStates, columns.n, **values, foot_force_n=feet, tick=np.nan)


JOINT_STATE = {"names": "name[]"} | dict(zip(JOINT_VALUES, ("position[]", "velocity[]", "effort[]"), strict=True))


def unitree(columns: Columns, order: JointOrder) -> Iterator[Part]:
    """Odometry, joints with feet, and IMU, as far as a message has them."""
    quat_xyzw, finite = unit_rows(columns["wxyz"][:, [1, 2, 3, 0]])
    absent = ~finite | ~columns["wxyz"].any(axis=1)
    if "position" in columns:
        linear_mps = columns["velocity"] * (1.0, 1.0, 0.0) if "velocity" in columns else 0.0
        yield part(
            Odometry,
            columns.n,
            position_m=sound_position_m(columns),
            quat_xyzw=np.where(absent[:, None], NO_TURN, quat_xyzw),
            linear_mps=linear_mps,
            angular_radps=np.column_stack([columns["rate"][:, :2], columns["yaw_rate"]]),
        )._replace(frames=("odom", ""))
    if "q" in columns:
        feet, tick = columns["feet"], columns["tick"] % TICKS if "tick" in columns else np.nan
        found = order.of_motors(columns["q"].shape[1], feet.shape[1], columns.topic)
        motors = zip(JOINT_VALUES, ("q", "dq", "tau"), strict=True)
        values: dict[str, Any] = {name: columns[each][:, found.place] * found.sign for name, each in motors}
        yield part(JointStates, columns.n, **values, foot_force_n=feet[:, found.feet], tick=tick)
    quat_xyzw[absent] = np.nan
    rates = {"angular_radps": columns["rate"], "linear_mps2": columns["acceleration"]}
    yield part(Imu, columns.n, quat_xyzw=quat_xyzw, **rates)


_STATE = {
    column: f"imu_state.{name} | imu.{name}"
    for column, name in (("wxyz", "quaternion[:4]"), ("rate", "gyroscope[:3]"), ("acceleration", "accelerometer[:3]"))
}
_WAY = {"position": "position[:3]", "yaw_rate": "yaw_speed | yawSpeed"}
_MOTORS = {
    "q": "motor_state[].q | motorState[].q ?",
    "dq": "motor_state[].dq | motorState[].dq ?",
    "tau": "motor_state[].tau_est | motorState[].tauEst ?",
    "feet": "foot_force[] | footForce[] ?",
    "tick": "tick ?",
}
# Since unitree_legged_sdk 3.8 with motors. No document says in which axes the velocity of SportModeState is.
LOW_STATE = Type((JointStates, Imu), HEADER | _STATE | _MOTORS, unitree)
HIGH_STATE = Type(
    (Odometry, JointStates, Imu), HEADER | _STATE | _WAY | {"velocity": "velocity[:3]"} | _MOTORS, unitree
)
SPORT_MODE = {"sec": "stamp.sec", "nanosec": "stamp.nanosec"} | _STATE | _WAY
