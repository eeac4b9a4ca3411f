"""Joints of quadrupeds by name and by order, from payloads that rosbags writes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.errors import DecodeError, UnknownJoints
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.ros_messages import BUNDLED
from tests.lab import decoded as lab

LEGS = ("FL", "FR", "RL", "RR")
UNITREE = [f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]


def named(form, ends, joints):
    return [form.format(end, joint) for end in ends.split() for joint in joints.split()]


STYLES = {
    "unitree": UNITREE,
    "unitree with _joint": [f"{name}_joint" for name in UNITREE],
    "anymal": named("{}_{}", "LF RF LH RH", "HAA HFE KFE"),
    "spot": named("{}_{}", "front_left front_right rear_left rear_right", "hip_x hip_y knee"),
    "spot, short": named("{}.{}", "fl fr hl hr", "hx hy kn"),
    "champ": named("{}_{}_joint", "lf rf lh rh", "hip upper_leg lower_leg"),
    "roll and pitch": named("{}_{}", "lf rf lh rh", "hip_roll hip_pitch knee_pitch"),
    "abduction": named("{}_{}", "FL FR BL BR", "abduction hip knee"),
    "camel case": named("{}{}", "frontLeft frontRight hindLeft hindRight", "Hip Thigh Calf"),
    "numbered": named("{}{}", "FL FR RL RR", "0 1 2"),
}
RANK = {"FR": 1, "FL": 0, "RR": 3, "RL": 2}


@cache
def store(ros: str) -> Any:
    made = get_typestore(Stores.ROS1_NOETIC if ros == "ros1" else Stores.ROS2_HUMBLE)
    for package in ("unitree_go", "ros2_unitree_legged_msgs"):
        for path in sorted((BUNDLED / package / "msg").glob("*.msg")):
            made.register(get_types_from_msg(path.read_text(), f"{package}/msg/{path.stem}"))
    # As in unitree_ros_to_real for ROS 1: other names for the same fields.
    for name in ("LowState", "HighState", "IMU", "MotorState", "BmsState", "Cartesian"):
        text = (BUNDLED / "ros2_unitree_legged_msgs" / "msg" / f"{name}.msg").read_text()
        camel = text.replace("motor_state", "motorState").replace("foot_force", "footForce")
        camel = camel.replace("tau_est", "tauEst").replace("yaw_speed", "yawSpeed")
        made.register(get_types_from_msg(camel, f"unitree_legged_msgs/msg/{name}"))
    return made


def payload_of(ros: str, message: Any) -> bytes:
    made, name = store(ros), message.__msgtype__
    return bytes(made.serialize_ros1(message, name) if ros == "ros1" else made.serialize_cdr(message, name))


def channel_of(ros: str, name: str, embedded: bool = True) -> Channel:
    version = 1 if ros == "ros1" else 2
    text = store(ros).generate_msgdef(name, ros_version=version)[0] if embedded else ""
    return Channel("/topic", name, "ros1" if ros == "ros1" else "cdr", f"ros{version}msg", text.encode())


def joint_state(ros: str, names: Any, position: Any = None, velocity: Any = (), effort: Any = ()) -> Any:
    kinds = store(ros).types
    stamp = kinds["builtin_interfaces/msg/Time"](5, 7)
    header = kinds["std_msgs/msg/Header"](*((0,) if ros == "ros1" else ()), stamp, "")
    values = np.arange(len(names)) if position is None else position
    arrays = (np.array(each, np.float64) for each in (values, velocity, effort))
    return kinds["sensor_msgs/msg/JointState"](header, list(names), *arrays)


def decoded(ros: str, message: Any, order: JointOrder | None = None, *, embedded: bool = True) -> tuple[Any, ...]:
    """What the message gives."""
    return lab.decoded(channel_of(ros, message.__msgtype__, embedded), payload_of(ros, message), order=order)


@given(style=st.sampled_from(sorted(STYLES)), data=st.data())
def test_joints_are_found_by_name_in_any_order(style: str, data: Any) -> None:
    """What a message leaves out is not a number."""
    names = STYLES[style]
    legs = ("FR", "FL", "RR", "RL") if style.startswith("unitree") else LEGS
    others = ["arm_1", "front_left_wheel", "FL_hip_rotor", "gripper"]
    mixed = data.draw(st.permutations([*names, *data.draw(st.lists(st.sampled_from(others), unique=True))]))
    numbers = np.arange(len(mixed), dtype=float)
    velocity, effort = (numbers[: data.draw(st.sampled_from([0, len(mixed)]))] for _ in range(2))
    ros = data.draw(st.sampled_from(["ros1", "ros2"]))
    (found,) = decoded(ros, joint_state(ros, mixed, velocity=-velocity, effort=2 * effort))
    expected = np.empty(12)
    for i, name in enumerate(names):
        expected[3 * RANK[legs[i // 3]] + i % 3] = mixed.index(name)
    np.testing.assert_array_equal(found.position_rad, expected)
    np.testing.assert_array_equal(found.velocity_radps, -expected if len(velocity) else np.full(12, np.nan))
    np.testing.assert_array_equal(found.torque_nm, 2 * expected if len(effort) else np.full(12, np.nan))
    assert np.isnan(found.foot_force_n).all()
    assert found.stamp_ns == 5_000_000_007


def test_the_effort_of_a_foot_is_its_force() -> None:
    names = [*UNITREE, *(f"{leg}_foot" for leg in LEGS)]
    (found,) = decoded("ros2", joint_state("ros2", names, effort=np.arange(16)))
    assert found.foot_force_n.tolist() == [12, 13, 14, 15]
    # Of a wheeled leg, it is the joint of a wheel.
    wheels = [*UNITREE, *(f"{leg}_foot_joint" for leg in LEGS)]
    (wheeled,) = decoded("ros2", joint_state("ros2", wheels, effort=np.arange(16)))
    assert np.isnan(wheeled.foot_force_n).all()


def test_configured_joints_by_name_place_and_sign() -> None:
    names = [f"motor{chr(97 + i)}" for i in range(13)]
    order = JointOrder([f"-{names[12 - i]}" if i % 2 else str(12 - i) for i in range(12)])
    (found,) = decoded("ros1", joint_state("ros1", names), order)
    assert found.position_rad.tolist() == [-(12.0 - i) if i % 2 else 12.0 - i for i in range(12)]


@pytest.mark.parametrize(
    ("names", "error", "words"),
    [
        (UNITREE[:11], DecodeError, "RL_calf"),
        ([*UNITREE[:11], UNITREE[0]], DecodeError, "FR_hip twice"),
        ([*UNITREE, "rf_haa"], DecodeError, "FR_hip twice"),
        ([f"m{i}" for i in range(12)], UnknownJoints, "--set 'robot.joints="),
        (["front_left_wheel", "rear_left_wheel"], UnknownJoints, "front_left_wheel"),
        (["rh_l1", "rh_r1", "rh_l2", "rh_r2"], UnknownJoints, "rh_l1"),
        (named("{}_{}", "FL FR RL RR", "hip knee"), DecodeError, "4 of a quadruped's 12"),
        ([f"joint_{i}" for i in range(10_000)], DecodeError, "10000"),
        ([], UnknownJoints, "none"),
    ],
)
def test_joints_that_are_not_known_are_told(names: list[str], error: type[Exception], words: str) -> None:
    with pytest.raises(error) as caught:
        JointOrder().of_names(tuple(names), "/topic")
    assert words in str(caught.value)
    assert len(str(caught.value)) < 1200
    message = joint_state("ros2", names)
    if error is UnknownJoints:  # of another machine: no failure
        assert decoded("ros2", message) == ()
    else:
        with pytest.raises(DecodeError, match=words):
            decoded("ros2", message)


@pytest.mark.parametrize("which", ["position", "velocity", "effort"])
def test_lists_of_different_lengths_are_refused(which: str) -> None:
    with pytest.raises(DecodeError):
        decoded("ros2", joint_state("ros2", UNITREE, **{which: np.zeros(11)}))


def filled(ros: str, name: str, **values: Any) -> Any:
    """A message whose numbers are zero, with some fields set."""
    made = store(ros)

    def zero(kind: int, detail: Any) -> Any:
        if kind == 1:
            return 0.0 if detail[0].startswith("float") else 0
        if kind == 2:
            return made.types[detail](*(zero(int(k), d) for _, (k, d) in made.fielddefs[detail][1]))
        (inner, what), count = detail
        return np.zeros(count, what[0]) if int(inner) == 1 else [zero(int(inner), what) for _ in range(count)]

    message = zero(2, name)
    for i, motor in enumerate(getattr(message, "motor_state", getattr(message, "motorState", []))):
        motor.q, motor.dq = float(i), -float(i)
        setattr(motor, "tau_est" if hasattr(motor, "tau_est") else "tauEst", 2.0 * i)
    imu = message.imu_state if hasattr(message, "imu_state") else message.imu
    imu.quaternion[:], imu.gyroscope[:], imu.accelerometer[:] = (0.8, 0.0, 0.0, 0.6), (0.25, 0.5, 0.75), (0, 0, 9.75)
    for field in ("foot_force", "footForce"):
        if hasattr(message, field):
            getattr(message, field)[:] = (10, 20, 30, 40)
    for field, value in values.items():
        getattr(message, field)[:] = value
    return message


LOW_STATES = [
    ("ros2", "unitree_go/msg/LowState"),
    ("ros2", "ros2_unitree_legged_msgs/msg/LowState"),
    ("ros1", "unitree_legged_msgs/msg/LowState"),
    ("ros2", "unitree_legged_msgs/msg/LowState"),
]


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize(("ros", "name"), LOW_STATES)
def test_low_states_are_in_unitrees_order(ros: str, name: str, embedded: bool) -> None:
    if not embedded and ros == "ros1":
        pytest.skip("ROS 1 bags embed all definitions")
    imu, joints = decoded(ros, filled(ros, name), embedded=embedded)
    assert joints.position_rad.tolist() == [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
    assert joints.torque_nm.tolist() == (2 * joints.position_rad).tolist() == (-2 * joints.velocity_radps).tolist()
    assert joints.foot_force_n.tolist() == [20, 10, 40, 30]
    np.testing.assert_allclose(imu.quat_xyzw, (0, 0, 0.6, 0.8), atol=1e-7)
    assert imu.angular_radps.tolist() == [0.25, 0.5, 0.75]
    assert imu.stamp_ns is joints.stamp_ns is None


def test_motors_can_be_configured_and_are_counted() -> None:
    order = JointOrder([f"-{i}" if i == 3 else str(i) for i in range(12)], [0, 1, 2, 3])
    _, joints = decoded("ros2", filled("ros2", LOW_STATES[0][1]), order)
    assert joints.position_rad.tolist() == [0, 1, 2, -3, 4, 5, 6, 7, 8, 9, 10, 11]
    assert joints.foot_force_n.tolist() == [10, 20, 30, 40]
    with pytest.raises(DecodeError, match="has no joint '20'"):
        decoded("ros2", filled("ros2", LOW_STATES[0][1]), JointOrder([*map(str, range(9, 21))]))
    with pytest.raises(DecodeError, match="4 feet"):
        decoded("ros2", filled("ros2", LOW_STATES[0][1]), JointOrder((), [1, 2, 3, 4]))


def test_high_and_sport_mode_states_give_odometry() -> None:
    for ros, name in (
        ("ros2", "ros2_unitree_legged_msgs/msg/HighState"),
        ("ros1", "unitree_legged_msgs/msg/HighState"),
    ):
        message = filled(ros, name, position=(1, 2, 0.25), velocity=(0.5, -0.25, 9))
        odometry, imu, joints = decoded(ros, message)
        assert odometry.position_m.tolist() == [1, 2, 0.25]
        assert odometry.linear_mps.tolist() == [0.5, -0.25, 0]
        assert odometry.quat_xyzw.tolist() == imu.quat_xyzw.tolist()
        assert joints.position_rad[0] == 3
    sport = filled("ros2", "unitree_go/msg/SportModeState", position=(1, 2, 0.25))
    sport.stamp.sec, sport.stamp.nanosec = 5, 7
    odometry, imu = decoded("ros2", sport, embedded=False)
    assert (odometry.stamp_ns, imu.stamp_ns) == (5_000_000_007, 5_000_000_007)
    assert odometry.position_m.tolist() == [1, 2, 0.25]
    sport.position[0] = np.nan
    with pytest.raises(DecodeError, match="position is not finite"):
        decoded("ros2", sport)
