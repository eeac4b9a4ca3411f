"""Joints in recordings that rosbags wrote, from the file to joints.parquet, and those that are wrong."""

from __future__ import annotations

import io
import os
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.lab.recordings import mcap
from tests.lab.strangers import LEGS as NAMES
from tests.lab.strangers import ROS, START_NS, Log

STEP_NS, N = 2_000_000, 1500
MOTORS = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]


def trot() -> tuple[np.ndarray, np.ndarray]:
    """Angles (N, 12) and foot forces (N, 4), FL, FR, RL, RR, of legs that swing in pairs."""
    lift = np.maximum(np.sin(2 * np.pi * (np.arange(N)[:, None] / 250 + np.array([0.0, 0.5, 0.5, 0.0]))), 0.0)
    joints = np.zeros((N, 4, 3))
    joints[..., 1], joints[..., 2] = 0.7 + 0.3 * lift, -1.4 - 0.6 * lift
    return joints.reshape(N, 12), np.where(lift > 0, 2.0, 70.0)


def go2_log(path: Path, feet: tuple[int, ...] = (1, 0, 3, 2), every_ns: int = STEP_NS) -> Path:
    """What a Go2's computer records, in SQLite and so without definitions; feet: the order in which forces are sent.

    every_ns: when a relay hands states on.
    """
    (position_rad, force_n), log = trot(), Log()
    still = ROS.make("unitree_go/msg/LowState", imu_state__quaternion=[1, 0, 0, 0])
    motor, force_n = still.motor_state[0], np.ascontiguousarray(force_n[:, feet], np.int16)
    for i in range(N):
        t_ns = START_NS + i * STEP_NS
        motors = [replace(motor, q=position_rad[i, joint]) for joint in MOTORS] + still.motor_state[12:]
        state = replace(still, motor_state=motors, foot_force=force_n[i], tick=(2**32 - 1000 + 2 * i) % 2**32)
        stamp = {"stamp__sec": t_ns // 10**9, "stamp__nanosec": t_ns % 10**9}
        log.add("/lowstate", START_NS - (START_NS - t_ns) // every_ns * every_ns, state)
        log.put("/sportmodestate", t_ns, "unitree_go/msg/SportModeState", position=[i * 1e-3, 0, 0], **stamp)
        if i % 25 == 0:
            log.add("/lf/lowstate", t_ns, state)
    return log.write(path.with_suffix(".db3"))


def joint_log(path: Path, names: list[str], odd: Mapping[int, Any] = MappingProxyType({}), count: int = 200) -> Path:
    """Joint states whose angles and efforts count upwards; odd: names, angles and efforts of some messages."""
    log, values = Log(), np.arange(len(names), dtype=float)
    for i in range(count):
        log.joints(START_NS + i * STEP_NS, *odd.get(i, (names, values + i, -values)))
    return log.write(path)


def test_a_go2_log_gives_joints_imu_and_odometry(tmp_path, replayed, described):
    log = go2_log(tmp_path / "walk")
    roles = {row["name"]: row["role"] for row in described(log)["topics"]}
    assert roles == {"/lowstate": "imu, joints", "/lf/lowstate": None, "/sportmodestate": "odometry"}
    done = replayed(log)
    assert (done.code, done.sources(), "foot forces" in done.err) == (0, {"odometry"}, False)
    (position_rad, force_n), joints = trot(), done.table("joints")
    assert joints["t_ns"].tolist() == [START_NS + i * STEP_NS for i in range(N)]
    for joint in range(12):
        np.testing.assert_allclose(joints[f"q_{joint:02d}_rad"], position_rad[:, joint], atol=1e-6)
    np.testing.assert_array_equal(joints["foot_force_0_n"], force_n[:, 0])
    pressed = force_n[:, 0] > 0.5 * force_n[:, 0].max()
    assert joints["contact_0"][pressed].mean() > 0.9 > 0.1 > joints["contact_0"][~pressed].mean()
    gait, poses = done.table("gait"), done.table("poses")
    assert gait["body"].tolist() == ["logged"]
    assert gait["stride_frequency_hz"][0] == pytest.approx(2.0, rel=0.01)
    assert gait["duty_factor_2"][0] == pytest.approx(0.5, abs=0.03)
    assert np.isnan(gait["cost_of_transport"][0])  # of a robot whose mass nobody configured
    # It stands level, whatever its legs do.
    assert np.nanmax(np.abs([poses["roll_rad"], poses["pitch_rad"]])) < 1e-6


def test_feet_in_another_order_are_configured(tmp_path, replayed):
    log = go2_log(tmp_path / "walk", feet=(0, 1, 2, 3))
    mended = replayed(log, "--set", "robot.feet=[0,1,2,3]", "--until", "position")
    np.testing.assert_array_equal(mended.table("joints")["foot_force_0_n"], trot()[1][:, 0])


def test_joints_of_unknown_names_are_named_with_the_key_to_paste(tmp_path, replayed):
    log = joint_log(tmp_path / "walk", [f"drive_{chr(97 + i)}" for i in range(12)])
    done = replayed(log)
    assert done.code == 1  # there is nothing else in the log
    assert "/joint_states names no joint of four legs, but drive_a, drive_b" in done.err
    known = replayed(log, "--set", shlex.split(done.err.partition("--set ")[2])[0])
    assert known.code == 3  # without forces or efforts no foot stands, and nothing else gives a position
    assert known.table("joints")["q_05_rad"].tolist() == [5.0 + i for i in range(200)]
    assert replayed(log, "--set", "topics.joints=/joint_states").code == 1


def test_broken_messages_are_counted_and_torques_that_are_no_numbers_said(tmp_path, replayed, described):
    odd = {
        50: (NAMES, np.zeros(11), np.zeros(12)),
        60: (NAMES[:11], np.zeros(11), np.zeros(11)),
        70: ([*NAMES[:11], NAMES[0]], np.zeros(12), np.zeros(12)),
        80: (["gripper"], np.zeros(1), np.zeros(1)),
        90: ([*NAMES, "arm_1"], np.zeros(13), np.full(13, np.nan)),
        100: ([*NAMES, "arm_1"], np.zeros(13), np.full(13, np.inf)),
    }
    log = joint_log(tmp_path / "walk", [*NAMES, "arm_1"], odd)
    done = replayed(log)
    assert (done.code, len(done.table("joints")["t_ns"])) == (3, 196)
    assert "3 messages could not be decoded; the first: names 12 joints, but has 11 positions" in done.err
    assert "24 of 2352 torques are no finite numbers" in done.err
    assert np.isnan(done.table("joints")["tau_03_nm"]).sum() == 2
    assert "others are left out: arm_1" in described(log)["topics"][0]["why"]


@pytest.mark.parametrize(
    "setting", ["robot.joints=['a','b']", "robot.feet=[0,0,1,2]", "robot.feet=[1,2]", "robot.preset=go2"]
)
def test_an_order_that_is_none_is_refused(setting, tmp_path, replayed):
    done = replayed(joint_log(tmp_path / "walk", NAMES, count=3), "--set", setting)
    assert done.code in (1, 2)
    assert setting.partition("=")[0] in done.err


def test_joints_in_bursts_are_placed_by_the_devices_tick(tmp_path, replayed):
    done = replayed(go2_log(tmp_path / "walk", every_ns=100_000_000), "--until", "position")
    off_ns = done.table("joints")["t_ns"] - START_NS - STEP_NS * np.arange(N)
    assert np.abs(off_ns).max() <= STEP_NS
    assert "/lowstate: joints come in bursts (" in done.err
    assert "are placed by the device's tick, in ms; as they are stamped:  --stamp header" in done.err


@pytest.mark.parametrize(
    ("every", "stamp", "stride_hz", "says"),
    [
        (1, "auto", 2.1, "13 silences above 0.1 s, 2.2 s in all, 19% of the log) and are placed at their usual rate"),
        (1, "header", None, "joints are silent for up to 0.4 s, 13 silences above 0.1 s, 2.2 s in all, 19% of the log"),
        (4, "auto", 2.1, "joints come 21 times a stride, at 44 Hz"),
    ],
)
def test_a_real_go2_walks_as_far_as_motion_capture_saw(every, stamp, stride_hz, says, tmp_path, replayed):
    """Recorded in bursts of which nothing but log times is known; every fourth state, evenly, stands for a slow log."""
    log = Path(os.environ.get("QUADLOG_DATASETS", "")) / "quadruped_go2" / "go2_bursts_12s.mcap"
    if not log.exists():
        pytest.skip("QUADLOG_DATASETS is not set, or without it")
    if every > 1:
        read = list(make_reader(io.BytesIO(log.read_bytes())).iter_messages())
        types = {channel.topic: (schema.name, schema.data.decode(), "") for schema, channel, _ in read}
        rows = [[channel.topic, m.log_time, m.data] for _, channel, m in read]
        states = [row for row in rows if row[0] == "/lowstate"]
        for row, t_ns in zip(states, np.linspace(states[0][1], states[-1][1], len(states)), strict=True):
            row[1] = int(t_ns)
        rows = states[::every] + [row for row in rows if row[0] != "/lowstate"]
        log = mcap(tmp_path / "even.mcap", sorted(rows, key=lambda row: row[1]), types)
    done = replayed(log, "--set", "robot.model=go2", "--stamp", stamp)
    poses, metrics = done.table("poses"), done.metrics
    step_m = np.hypot(np.diff(poses["x_m"]), np.diff(poses["y_m"]))
    assert (done.code, step_m.max() < 0.3, 6.0 < step_m.sum() < 9.0) == (0, True, True), done.err
    assert metrics["ate_aligned_rmse_m"]["value"] < (0.25 if stride_hz else 0.35)
    assert (says in done.said, "move against the ground" in done.said) == (True, False), done.said
    if stride_hz is None:
        assert "logged_stride_frequency_hz" not in metrics
    else:
        assert metrics["logged_stride_frequency_hz"]["value"] == pytest.approx(stride_hz, abs=0.1)
        assert metrics["logged_duty_factor"]["value"] == pytest.approx(0.52, abs=0.03)
