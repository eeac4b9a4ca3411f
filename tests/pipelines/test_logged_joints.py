"""Joints in recordings that rosbags wrote, from the file to joints.parquet, and those that are wrong."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Db3Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.config.schema import Config
from quadlog.lidar.levelling import level_rotations
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.info import describe_recording
from quadlog.pipelines.log import open_log, read_log
from quadlog.pipelines.request import ReplayOptions
from quadlog.recordings.decoders.ros_messages import BUNDLED

T0_NS, STEP_NS, N = 1_700_000_000 * 10**9, 2_000_000, 1500
LEGS = ("FL", "FR", "RL", "RR")
NAMES = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")]
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
for _path in sorted((BUNDLED / "unitree_go" / "msg").glob("*.msg")):
    ROS2.register(get_types_from_msg(_path.read_text(), f"unitree_go/msg/{_path.stem}"))


def trot() -> tuple[np.ndarray, np.ndarray]:
    """Angles (N, 12) and foot forces (N, 4), FL, FR, RL, RR, of legs that swing in pairs."""
    lift = np.maximum(np.sin(2 * np.pi * (np.arange(N)[:, None] / 250 + np.array([0.0, 0.5, 0.5, 0.0]))), 0.0)
    joints = np.zeros((N, 4, 3))
    joints[..., 1], joints[..., 2] = 0.7 + 0.3 * lift, -1.4 - 0.6 * lift
    return joints.reshape(N, 12), np.where(lift > 0, 2.0, 70.0)


def zeros(kind: int, detail: Any) -> Any:
    if kind == 1:
        return 0.0 if detail[0].startswith("float") else 0
    if kind == 2:
        return ROS2.types[detail](*(zeros(int(k), d) for _, (k, d) in ROS2.fielddefs[detail][1]))
    (inner, what), count = detail
    return np.zeros(count, what[0]) if int(inner) == 1 else [zeros(int(inner), what) for _ in range(count)]


def go2_log(path: Path, feet: tuple[int, ...] = (1, 0, 3, 2)) -> Path:
    """What a Go2's computer records, in SQLite and so without definitions; feet: the order in which forces are sent."""
    position_rad, force_n = trot()
    motors = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
    topics = {"/lowstate": "LowState", "/lf/lowstate": "LowState", "/sportmodestate": "SportModeState"}
    with Db3Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for topic, kind in topics.items():
            name = f"unitree_go/msg/{kind}"
            connection, message = writer.add_connection(topic, name, typestore=ROS2), zeros(2, name)
            message.imu_state.quaternion[0] = 1.0
            for i in range(0, N, 25 if topic.startswith("/lf") else 1):
                if kind == "LowState":
                    for place, joint in enumerate(motors):
                        message.motor_state[place].q = position_rad[i, joint]
                    message.foot_force[:] = force_n[i, list(feet)]
                else:
                    message.stamp = ROS2.types["unitree_go/msg/TimeSpec"](T0_NS // 10**9, i * STEP_NS % 10**9)
                    message.stamp.sec += i * STEP_NS // 10**9
                    message.position[0] = i * 1e-3
                writer.write(connection, T0_NS + i * STEP_NS, ROS2.serialize_cdr(message, name))
    return path


def joint_bag(path: Path, rows: Iterable[tuple[list[str], np.ndarray, np.ndarray]]) -> Path:
    """A ROS 1 bag of joint states: names, positions and efforts of each."""
    kinds = ROS1.types
    with BagWriter(path) as writer:
        name = "sensor_msgs/msg/JointState"
        connection = writer.add_connection("/joint_states", name, typestore=ROS1)
        for i, (names, position, effort) in enumerate(rows):
            t_ns = T0_NS + i * STEP_NS
            stamp = kinds["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
            header = kinds["std_msgs/msg/Header"](i, stamp, "")
            message = kinds[name](header, names, position, np.zeros(0), effort)
            writer.write(connection, t_ns, ROS1.serialize_ros1(message, name))
    return path


def numbered(names: list[str], count: int = 200) -> list[tuple[list[str], np.ndarray, np.ndarray]]:
    values = np.arange(len(names), dtype=float)
    return [(names, values + i, -values) for i in range(count)]


def test_a_go2_log_gives_joints_imu_and_odometry(tmp_path: Path, replay_command: Callable[..., Any]) -> None:
    log = go2_log(tmp_path / "walk")
    roles = {row["name"]: row["role"] for row in describe_recording(log, Config())["topics"]}
    assert roles == {"/lowstate": "imu, joints", "/lf/lowstate": None, "/sportmodestate": "odometry"}
    result = replay_command(log, "--no-plots")
    assert result.code == 0
    assert set(result.table("poses")["source"]) == {"odometry"}
    position_rad, force_n = trot()
    joints = result.table("joints")
    assert joints["t_ns"].tolist() == [T0_NS + i * STEP_NS for i in range(N)]
    for joint in range(12):
        np.testing.assert_allclose(joints[f"q_{joint:02d}_rad"], position_rad[:, joint], atol=1e-6)
    np.testing.assert_array_equal(joints["foot_force_0_n"], force_n[:, 0])
    pressed = force_n[:, 0] > 0.5 * force_n[:, 0].max()
    assert joints["contact_0"][pressed].mean() > 0.9 > 0.1 > joints["contact_0"][~pressed].mean()
    assert "foot forces" not in result.err
    gait = result.table("gait")
    assert gait["body"].tolist() == ["logged"]
    assert gait["stride_frequency_hz"][0] == pytest.approx(2.0, rel=0.01)
    assert gait["duty_factor_2"][0] == pytest.approx(0.5, abs=0.03)
    assert np.isnan(gait["cost_of_transport"][0])  # of a robot whose mass nobody configured


def test_a_go2_that_stands_level_is_level_whatever_its_legs_do(tmp_path: Path) -> None:
    with open_log(go2_log(tmp_path / "walk"), Config(), ReplayOptions()) as log:
        up = read_log(log, Progress()).up
    assert up is not None
    rotations, why_not = level_rotations(np.array([T0_NS + (N - 1) * STEP_NS]), up)
    assert why_not is None
    np.testing.assert_allclose(rotations, [np.eye(3)], atol=1e-9)


def test_swapped_feet_are_warned_of_with_the_order_that_fits(
    tmp_path: Path, replay_command: Callable[..., Any]
) -> None:
    log = go2_log(tmp_path / "walk", feet=(0, 1, 2, 3))
    result = replay_command(log, "--no-plots")
    assert result.code == 0
    assert "--set robot.feet=[0,1,2,3]" in result.err
    mended = replay_command(log, "--no-plots", "--set", "robot.feet=[0,1,2,3]", "--force")
    assert "foot forces" not in mended.err
    np.testing.assert_array_equal(mended.table("joints")["foot_force_0_n"], trot()[1][:, 0])


def test_joints_of_unknown_names_are_told_with_the_key_to_paste(
    tmp_path: Path, replay_command: Callable[..., Any]
) -> None:
    names = [f"drive_{chr(97 + i)}" for i in range(12)]
    log = joint_bag(tmp_path / "walk.bag", numbered(names))
    result = replay_command(log, "--no-plots")
    assert result.code == 1  # there is nothing else in the log
    assert "/joint_states names no joint of four legs, but drive_a, drive_b" in result.err
    chosen = replay_command(log, "--no-plots", "--set", "topics.joints=/joint_states")
    assert (chosen.code, "topics.joints: /joint_states cannot be used" in chosen.err) == (1, True)
    flag = result.err.partition("--set ")[2]
    known = replay_command(log, "--no-plots", "--set", shlex.split(flag)[0], "--force")
    assert known.code == 3  # without forces or efforts no foot stands, and nothing else gives a position
    assert known.table("joints")["q_05_rad"].tolist() == [5.0 + i for i in range(200)]


def test_wheels_are_no_legs_and_no_loss(tmp_path: Path, replay_command: Callable[..., Any]) -> None:
    log = joint_bag(tmp_path / "walk.bag", numbered(["front_left_wheel", "rear_left_wheel"]))
    info = describe_recording(log, Config())
    assert info["losses"] == []
    assert info["topics"][0]["why"] == "names no joint of four legs, but front_left_wheel, rear_left_wheel"


def test_broken_messages_are_counted_and_torques_that_are_no_numbers_said(
    tmp_path: Path, replay_command: Callable[..., Any]
) -> None:
    rows = numbered([*NAMES, "arm_1"])
    rows[50] = (NAMES, np.zeros(11), np.zeros(12))
    rows[60] = (NAMES[:11], np.zeros(11), np.zeros(11))
    rows[70] = ([*NAMES[:11], NAMES[0]], np.zeros(12), np.zeros(12))
    rows[80] = (["gripper"], np.zeros(1), np.zeros(1))
    rows[90] = ([*NAMES, "arm_1"], np.zeros(13), np.full(13, np.nan))
    rows[100] = ([*NAMES, "arm_1"], np.zeros(13), np.full(13, np.inf))
    log = joint_bag(tmp_path / "walk.bag", rows)
    result = replay_command(log, "--no-plots")
    assert result.code == 3
    assert "3 messages could not be decoded; the first: names 12 joints, but has 11 positions" in result.err
    assert "24 of 2352 torques are no finite numbers" in result.err
    assert len(result.table("joints")["t_ns"]) == 196
    assert "others are left out: arm_1" in describe_recording(log, Config())["topics"][0]["why"]
    assert np.isnan(result.table("joints")["tau_03_nm"]).sum() == 2


@pytest.mark.parametrize(
    "setting", ["robot.joints=['a','b']", "robot.feet=[0,0,1,2]", "robot.feet=[1,2]", "robot.preset=spot"]
)
def test_an_order_that_is_none_is_refused(setting: str, tmp_path: Path, replay_command: Callable[..., Any]) -> None:
    log = joint_bag(tmp_path / "walk.bag", numbered(NAMES, 3))
    result = replay_command(log, "--no-plots", "--set", setting)
    assert result.code in (1, 2)
    assert setting.partition("=")[0] in result.err
