"""Joints of quadrupeds by name and by order, from payloads that rosbags writes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import DecodeError, UnknownJoints
from quadlog.recordings.decoders.joints import JointOrder
from tests.lab import decoded as lab
from tests.lab.messages import channel_of, serialised, zeroed

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


def joint_state(kind: str, names: Any, position: Any = None, velocity: Any = (), effort: Any = ()) -> Any:
    values = np.arange(len(names)) if position is None else position
    arrays = {"position": values, "velocity": velocity, "effort": effort}
    message = zeroed(kind, "sensor_msgs/msg/JointState", name=list(names), **arrays)
    message.header.stamp.sec, message.header.stamp.nanosec = 5, 7
    return message


def decoded(kind: str, message: Any, order: JointOrder | None = None, *, embedded: bool = True) -> tuple[Any, ...]:
    """What the message gives."""
    channel = channel_of(kind, message.__msgtype__, embedded=embedded)
    return lab.decoded(channel, serialised(kind, message), order=order)


@given(style=st.sampled_from(sorted(STYLES)), data=st.data())
def test_joints_are_found_by_name_in_any_order(style: str, data: Any) -> None:
    """What a message leaves out is not a number."""
    names = STYLES[style]
    legs = ("FR", "FL", "RR", "RL") if style.startswith("unitree") else LEGS
    others = ["arm_1", "front_left_wheel", "FL_hip_rotor", "gripper"]
    mixed = data.draw(st.permutations([*names, *data.draw(st.lists(st.sampled_from(others), unique=True))]))
    numbers = np.arange(len(mixed), dtype=float)
    velocity, effort = (numbers[: data.draw(st.sampled_from([0, len(mixed)]))] for _ in range(2))
    ros = data.draw(st.sampled_from(["ros1", "little"]))
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
    (found,) = decoded("little", joint_state("little", names, effort=np.arange(16)))
    assert found.foot_force_n.tolist() == [12, 13, 14, 15]
    # Of a wheeled leg, it is the joint of a wheel.
    wheels = [*UNITREE, *(f"{leg}_foot_joint" for leg in LEGS)]
    (wheeled,) = decoded("little", joint_state("little", wheels, effort=np.arange(16)))
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
    message = joint_state("little", names)
    if error is UnknownJoints:  # of another machine: no failure
        assert decoded("little", message) == ()
    else:
        with pytest.raises(DecodeError, match=words):
            decoded("little", message)


@pytest.mark.parametrize("which", ["position", "velocity", "effort"])
def test_lists_of_different_lengths_are_refused(which: str) -> None:
    with pytest.raises(DecodeError):
        decoded("little", joint_state("little", UNITREE, **{which: np.zeros(11)}))


def filled(kind: str, name: str, **values: Any) -> Any:
    """A message whose numbers are zero, with some fields set."""
    message = zeroed(kind, name, **values)
    for i, motor in enumerate(getattr(message, "motor_state", getattr(message, "motorState", []))):
        motor.q, motor.dq = float(i), -float(i)
        setattr(motor, "tau_est" if hasattr(motor, "tau_est") else "tauEst", 2.0 * i)
    imu = message.imu_state if hasattr(message, "imu_state") else message.imu
    imu.quaternion[:], imu.gyroscope[:], imu.accelerometer[:] = (0.8, 0.0, 0.0, 0.6), (0.25, 0.5, 0.75), (0, 0, 9.75)
    for field in ("foot_force", "footForce"):
        if hasattr(message, field):
            getattr(message, field)[:] = (10, 20, 30, 40)
    return message


LOW_STATES = [
    ("little", "unitree_go/msg/LowState"),
    ("little", "ros2_unitree_legged_msgs/msg/LowState"),
    ("ros1", "unitree_legged_msgs/msg/LowState"),
    ("little", "unitree_legged_msgs/msg/LowState"),
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
    _, joints = decoded("little", filled("little", LOW_STATES[0][1]), order)
    assert joints.position_rad.tolist() == [0, 1, 2, -3, 4, 5, 6, 7, 8, 9, 10, 11]
    assert joints.foot_force_n.tolist() == [10, 20, 30, 40]
    with pytest.raises(DecodeError, match="has no joint '20'"):
        decoded("little", filled("little", LOW_STATES[0][1]), JointOrder([*map(str, range(9, 21))]))
    with pytest.raises(DecodeError, match="4 feet"):
        decoded("little", filled("little", LOW_STATES[0][1]), JointOrder((), [1, 2, 3, 4]))


def test_high_and_sport_mode_states_give_odometry() -> None:
    for ros, name in (
        ("little", "ros2_unitree_legged_msgs/msg/HighState"),
        ("ros1", "unitree_legged_msgs/msg/HighState"),
    ):
        message = filled(ros, name, position=(1, 2, 0.25), velocity=(0.5, -0.25, 9))
        odometry, imu, joints = decoded(ros, message)
        assert odometry.position_m.tolist() == [1, 2, 0.25]
        assert odometry.linear_mps.tolist() == [0.5, -0.25, 0]
        assert odometry.quat_xyzw.tolist() == imu.quat_xyzw.tolist()
        assert joints.position_rad[0] == 3
    sport = filled("little", "unitree_go/msg/SportModeState", position=(1, 2, 0.25))
    sport.stamp.sec, sport.stamp.nanosec = 5, 7
    odometry, imu = decoded("little", sport, embedded=False)
    assert (odometry.stamp_ns, imu.stamp_ns) == (5_000_000_007, 5_000_000_007)
    assert odometry.position_m.tolist() == [1, 2, 0.25]
    sport.position[0] = np.nan
    with pytest.raises(DecodeError, match="position is not finite"):
        decoded("little", sport)
