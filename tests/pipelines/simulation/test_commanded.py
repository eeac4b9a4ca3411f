"""`--controller command`: a body that really walked by commands, once more by these alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import quadlog
from quadlog.cli.main import run as run_cli
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.simulation.commanded import held
from quadlog.simulation.robot.height_field import flat
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.walking_robot import WalkingRobot
from tests.lab.strangers import LEGS, ROS, Log, instants_s, ns

TWIST = (0.4, 0.3, -0.1)
"""Ahead, yaw rate, to the left; from a second on until the fifth."""
FEET = [f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")]
ROBOT = ("--set", "robot.model=tracking", "--set", "simulation.tick_s=0.002")


def command(ahead: float, rate: float, left: float):
    return ROS.make("geometry_msgs/msg/Twist", linear=ROS.vector(ahead, left, 0), angular=ROS.vector(0, 0, rate))


def stamped(t_ns: int, twist):
    return ROS.make("geometry_msgs/msg/TwistStamped", header=ROS.header(t_ns, "base"), twist=twist)


@pytest.fixture(scope="module")
def walked() -> Log:
    """Six seconds: joints with feet at 100 Hz and odometry at 50 Hz of a simulated body, without a lidar."""
    log, model = Log(), quadruped_model(ROBOTS["tracking"], flat())
    robot = WalkingRobot(model, WalkerSettings(), np.array([1.0, -2.0, 0.6]), np.random.default_rng(0))
    for tick in range(600):
        t_ns = ns(tick * 0.01)
        if tick % 2 == 0:
            log.odometry(t_ns, robot.pose.tolist())
        rates = robot.state.qvel[6:]
        values = {"position": [*robot.joints[model.joint_qpos], *[0.0] * 4], "velocity": [*rates, *[0.0] * 4]}
        values["effort"] = [*robot.torques_nm, *robot.foot_loads_n]
        log.put("/joint_states", t_ns, "sensor_msgs/msg/JointState", "", name=LEGS + FEET, **values)
        robot.walk(5, *(TWIST if 100 <= tick < 500 else (0.0, 0.0, 0.0)))
    return log


def recorded(walked: Log, folder: Path, *topics: str, hz: float = 10.0, until_s: float = 4.95) -> Path:
    """The same log with commands on topics; stamped ones have the suffix `_stamped`."""
    log = Log()
    log.messages = [*walked.messages]
    for topic in topics:
        for t_s in [*instants_s(until_s, hz)[round(hz) :], 5.0]:
            twist = command(*(TWIST if t_s < 5 else (0, 0, 0)))
            if topic.endswith("_stamped"):
                log.put(topic, ns(t_s), "geometry_msgs/msg/TwistStamped", "base", twist=twist)
            else:
                log.add(topic, ns(t_s), twist)
    return log.write(folder / "log")


def commanded(path: Path, output: Path, *words: str) -> quadlog.Run:
    arguments = ["replay", str(path), "--controller", "command", "--no-plots", *ROBOT, *words, "-o", str(output)]
    assert run_cli(arguments) == 0
    return quadlog.load_run(output / "log")


@pytest.mark.parametrize("topic", ["/cmd_vel", "/cmd_vel_stamped"])
def test_the_same_body_by_the_same_commands_is_where_it_was(walked, tmp_path, capsys, topic):
    run = commanded(recorded(walked, tmp_path, topic), tmp_path / "runs")
    control = run.table("control")
    assert run.metric("fallen") == 0
    for name in ("eta_time_m", "heading_rmse_rad", "speed_difference_rms_mps"):
        assert run.metric(name) < 1e-9, name
    assert run.metric("torque_rms_nm") == pytest.approx(run.metric("logged_torque_rms_nm"), rel=0.05)
    assert run.metric("duty_factor") == pytest.approx(run.metric("logged_duty_factor"), abs=0.05)
    assert control[["cmd_v_mps", "cmd_yaw_rate_radps", "cmd_vy_mps"]].iloc[150].tolist() == list(TWIST)
    assert control[["cmd_v_mps", "cmd_yaw_rate_radps", "cmd_vy_mps"]].iloc[20].tolist() == [0, 0, 0]
    assert [(each.role, each.topic) for each in run.record.topics if each.role == "command"] == [("command", topic)]
    printed = " ".join("".join(capsys.readouterr()).split())
    assert "by the log's commands without a fall; it was" in printed
    assert "no topic is fit to be the lidar" in printed
    assert "counts as 0" not in printed, "the last command was to stop"


def test_a_log_of_commands_alone_is_walked_as_long_as_it_has_commands(tmp_path):
    recorded(Log(), tmp_path, "/cmd_vel")
    control = commanded(tmp_path / "log", tmp_path / "runs").table("control")
    assert np.ptp(control["t_ns"]) == ns(5.0) - ns(1.0)
    assert control["x_m"].iloc[-1] > 1.0


def test_what_differs_between_simulation_and_log_is_measured(walked, tmp_path):
    """A log whose robot goes a quarter faster and turns half as fast again as it is told, with the walker's ramps."""
    log = Log()
    log.messages = [each for each in walked.messages if each[1] != "/odom"]
    t_s = np.arange(0.0, 6.0, 0.001)
    speed_mps, rate_radps = (
        np.interp(t_s, [1, 1 + most / ramp, 5, 5 + most / ramp], [0, most, most, 0])
        for most, ramp in ((0.4, 1.0), (0.3, 4.0))
    )
    ways = []
    for faster, turns_faster in ((1.0, 1.0), (1.25, 1.5)):
        yaw_rad = np.cumsum(turns_faster * rate_radps) * 1e-3
        steps_m = faster * speed_mps[:, None] * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)]) * 1e-3
        ways.append(np.column_stack([np.cumsum(steps_m, axis=0), yaw_rad]))
    for row in range(0, len(t_s), 20):
        log.odometry(ns(t_s[row]), tuple(ways[1][row].tolist()))
    for row in range(1000, 5001, 100):
        log.add("/cmd_vel", ns(t_s[row]), command(0.4, 0.3, 0.0) if row < 5000 else command(0, 0, 0))
    run = commanded(log.write(tmp_path / "log"), tmp_path / "runs")
    assert run.metric("speed_difference_rms_mps") == pytest.approx(0.25 * np.sqrt(np.mean(speed_mps**2)), abs=0.02)
    last = run.table("control").iloc[-1]
    assert last["heading_error_rad"] == pytest.approx(ways[0][-1, 2] - ways[1][-1, 2], abs=0.03)
    assert last["time_error_m"] == pytest.approx(np.hypot(*(ways[0] - ways[1])[-1, :2]), abs=0.06)
    assert 0 < last["error_m"] < last["time_error_m"]
    assert last["cross_track_m"] < 0, "it turned less to the left"


@pytest.mark.parametrize(
    ("topics", "words", "code", "says"),
    [
        ((), (), 1, "control: no topic is fit to be the command"),
        (("/a/cmd_vel", "/b/cmd_vel"), (), 1, "--set topics.command=/b/cmd_vel"),
        (("/a/cmd_vel", "/b/cmd_vel"), ("--set", "topics.command=/b/cmd_vel"), 0, "stopped after control"),
        (("/cmd_vel",), ("--set", "topics.command=/joint_states"), 1, "/cmd_vel"),
        (("/cmd_vel",), ("--until", "position"), 0, "usable"),
        (("/cmd_vel",), ("--until", "control"), 0, "usable"),
        (("/cmd_vel",), ("--until", "plan"), 1, "no topic is fit to be the lidar"),
        (("/cmd_vel",), ("--start", "5.5"), 0, "the log holds no command in this time"),
    ],
)
def test_which_commands(walked, tmp_path, capsys, topics, words, code, says):
    path = recorded(walked, tmp_path, *topics)
    short = () if code or "--start" in words else ("--duration", "1.5")
    arguments = ["replay", str(path), "--controller", "command", "--no-plots", *ROBOT, "-o", str(tmp_path / "runs")]
    assert run_cli([*arguments, *short, *words]) == code
    assert says in " ".join("".join(capsys.readouterr()).split())


def test_a_command_that_is_late_counts_as_none(walked, tmp_path, capsys):
    path = recorded(walked, tmp_path, "/cmd_vel", until_s=2.05)
    run = commanded(path, tmp_path / "runs")
    printed = " ".join("".join(capsys.readouterr()).split())
    assert "the last command is older than 0.5 s and counts as 0" in printed
    again = commanded(path, tmp_path / "held", "--set", "simulation.command_hold_s=10")
    assert "counts as 0" not in "".join(capsys.readouterr())
    tables = [each.table("control") for each in (run, again)]
    walks_m = [float(np.hypot(each["x_m"].diff(), each["y_m"].diff()).sum()) for each in tables]
    assert walks_m[0] < 0.8 < 1.4 < walks_m[1]


def test_held_commands_are_those_before_an_instant_and_none_for_ever():
    t_ns, twist = np.array([0, 10, 11, 15, 16, 30]) * 10**8, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    found, stale = held(t_ns, np.array([10, 11]) * 10**8, twist, 0.5)
    np.testing.assert_array_equal(found[:, 0], [0, 1, 4, 4, 4, 0])
    np.testing.assert_array_equal(stale, [False] * 5 + [True])


def test_what_a_robot_did_by_its_sportmodestate_is_a_command(walked, tmp_path):
    """It names no axes for its velocity: its poses give that, in the body's axes."""
    log = Log()
    log.messages = [*walked.messages]
    poses = [(t_ns, each.pose.pose) for t_ns, topic, each in walked.messages if topic == "/odom"]
    for t_ns, at in poses:
        state = ROS.make("unitree_go/msg/SportModeState")
        state.imu_state.quaternion[:] = at.orientation.w, 0, 0, at.orientation.z
        state.position[:] = at.position.x, at.position.y, 0.3
        log.add("/sportmodestate", t_ns, state)
    path = tmp_path / "log"
    log.write(path)
    run = commanded(path, tmp_path / "runs", "--set", "topics.command=/sportmodestate")
    control = run.table("control")
    steady = control.iloc[120:240]
    np.testing.assert_allclose(steady[["cmd_v_mps", "cmd_vy_mps"]].mean(), [TWIST[0], TWIST[2]], atol=0.03)
