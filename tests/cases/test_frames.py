"""Frames, mounts and clocks of logs that nobody here has seen: what info foretells, what a replay of a part does."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from quadlog.cli.main import run as run_cli
from quadlog.results.tables import read_table
from tests.lab.strangers import Log, Room, add_scans, instants_s, message, ns

LEGS = [f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")]


def way(log: Log, parent: str = "odom", child: str = "base_footprint") -> None:
    for t_s in instants_s(8.0, 20):
        log.tf(ns(t_s), parent, child, Room(6.0).at(t_s))


def test_info_ends_with_chains_of_frames_and_how_far_a_replay_will_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Log()
    way(log)
    log.tf(ns(0.0), "base_footprint", "base_link", (0.0, 0.0, 0.0), 0.1, "/tf_static")
    for t_s in instants_s(8.0, 5):
        log.tf(ns(t_s), "base_link", "laser", (0.0, 0.0, np.pi), 0.1)
        log.tf(ns(t_s), "world", "drone", (t_s, 0.0, 0.0))
    add_scans(log, Room(6.0), 1.0)
    assert run_cli(["info", str(log.write(tmp_path / "log"))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "tf: odom → base_footprint (160)" in lines
    assert "tf: world → drone (40)" in lines
    assert not any("laser (" in line for line in lines)
    expected = "a replay will go to: control; position: tf odom → base_footprint; target: ahead; missing: nothing"
    assert lines[-1] == expected


def scanners(log: Log) -> None:
    for name in ("front", "rear"):
        add_scans(log, Room(6.0), 2.0, topic=f"/{name}/scan", frame=f"{name}_laser")


def each(*kinds: Callable[[Log, float], None]) -> Callable[[Log], None]:
    """Two seconds of what every kind adds at an instant."""

    def make(log: Log) -> None:
        for t_s in instants_s(2.0, 20):
            for add in kinds:
                add(log, t_s)

    return make


def odometry(topic: str = "/odom") -> Callable[[Log, float], None]:
    return lambda log, t_s: log.odometry(ns(t_s), Room(6.0).at(t_s), topic)


def pose(topic: str) -> Callable[[Log, float], None]:
    return lambda log, t_s: log.pose(ns(t_s), Room(6.0).at(t_s), topic)


def ranges(topic: str) -> Callable[[Log, float], None]:
    return lambda log, t_s: log.range(ns(t_s), topic, 2.0)


def joints(*names: str) -> Callable[[Log, float], None]:
    return lambda log, t_s: log.joints(ns(t_s), list(names))


def imu_of_another_clock(log: Log, t_s: float) -> None:
    log.imu(ns(t_s), 9.81)
    log.messages[-1][2].header.stamp.sec -= 86400


FORETOLD: dict[str, tuple[Callable[[Log], None], str, str, str]] = {
    "two-lidars": (
        scanners,
        "",
        "nothing",
        "choose with  --set topics.lidar=/front/scan  or  --set topics.lidar=/rear",
    ),
    "two-lidars-and-odometry": (
        lambda log: (scanners(log), each(odometry())(log))[-1],
        "",
        "odometry",
        "choose with  --set topics.lidar=/front/scan",
    ),
    "two-odometries": (each(odometry("/a"), odometry("/b")), "", "nothing", "--set topics.odometry=/b"),
    "wheels": (each(joints("left", "right")), "", "nothing", "/joint_states names no joint of four legs, but left"),
    "a-message-a-leg": (
        each(joints(*LEGS[:3]), joints(*LEGS[3:6])),
        "",
        "nothing",
        "no joint of four legs, but FL_hip",
    ),
    "ranges-without-ends": (
        each(ranges("/range_a"), ranges("/range_b")),
        "",
        "nothing",
        "/range_b is a Range without tag and anchor; if it is UWB, map it in [[uwb.range_topics]]",
    ),
    "ranges-without-anchors": (
        each(ranges("/uwb/tag0/anchor1"), pose("/vicon/robot")),
        "",
        "fixed",
        "--set topics.position=/vicon/robot; UWB ranges need [[uwb.anchors]], see  quadlog survey",
    ),
    "two-poses": (
        each(pose("/a"), pose("/b")),
        "",
        "fixed",
        "what could give it:  --set topics.position=/a  or  --set topics.position=/b",
    ),
    "another-payload": (
        each(odometry()),
        "",
        "nothing",
        "/odom cannot be decoded: not a nav_msgs/msg/Odometry",
    ),
    "another-payload-beside-joints": (
        each(odometry(), joints(*LEGS)),
        "",
        "legs",
        "not a nav_msgs/msg/Odometry: Invalid",
    ),
    "two-clocks": (each(odometry(), imu_of_another_clock), "", "nothing", "cannot be compared; use  --stamp log"),
    "a-source-that-is-not-there": (
        each(odometry()),
        '[topics]\nposition = "tf"',
        "nothing",
        "topics.position = 'tf', but no moving transforms lead from 'map' to the robot's frame; what could give it",
    ),
    "no-topics": (lambda log: None, "", "nothing", "no message of a type that quadlog uses"),
}
"""A log, a configuration, what will give the position or that there is nothing to replay, and what is missing."""


@pytest.mark.parametrize("name", FORETOLD)
def test_info_foretells_what_a_replay_does_and_says(name: str, tmp_path: Path, described: Any, replayed: Any) -> None:
    make, config, position, missing = FORETOLD[name]
    log = Log()
    make(log)
    path = log.write(tmp_path / "log", StoragePlugin.SQLITE3)
    if name.startswith("another-payload"):
        with contextlib.closing(sqlite3.connect(next(path.glob("*.db3")))) as store, store:
            odometry_alone = "topic_id = (SELECT id FROM topics WHERE name = '/odom')"
            store.execute(f"UPDATE messages SET data = CAST(x'0007' || substr(data, 3) AS BLOB) WHERE {odometry_alone}")
    outlook, done = described(path, config)["replay"], replayed(path, config=config)
    assert missing in "; ".join(outlook["missing"])
    assert missing in done.err
    if position == "nothing":
        assert (outlook["until"], done.code) == ("nothing", 1)
    else:
        assert (outlook["until"], outlook["position"], done.sources()) == ("position", position, {position})


@pytest.mark.parametrize("kind", ["tf", "joints"])
def test_transforms_and_joints_alone_have_a_length_and_parts(kind: str, tmp_path: Path) -> None:
    log = Log()
    if kind == "tf":
        way(log)
    for t_s in instants_s(8.0, 20) if kind == "joints" else ():
        log.joints(ns(t_s), LEGS)
    path, runs = str(log.write(tmp_path / "log")), tmp_path / "runs"
    assert run_cli(["replay", path, "-o", str(runs), "--no-plots", "--start", "2", "--duration", "3"]) == 0
    record = json.loads((runs / "log" / "run.json").read_text())
    assert record["recorded_s"] == pytest.approx(2.95)
    t_ns = read_table(runs / "log", "poses" if kind == "tf" else "joints")["t_ns"]
    assert (t_ns[0], t_ns[-1]) == (ns(2.0), ns(4.95))


def on_another_clock(log: Log, *, years: int = 1) -> None:
    """Stamps of the robot's own clock, which is set wrong."""
    for _, _, content in log.messages:
        content.header.stamp.sec -= years * 365 * 86400


def test_a_reference_without_stamps_does_not_stop_a_replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = Log()
    for t_s in instants_s(8.0, 20):
        log.odometry(ns(t_s), Room(6.0).at(t_s))
        log.pose(ns(t_s), Room(6.0).at(t_s), "/mocap/pose")
    on_another_clock(log)
    for _, topic, content in log.messages:
        if topic == "/mocap/pose":
            content.header.stamp.sec = content.header.stamp.nanosec = 0
    arguments = ["-o", str(tmp_path / "runs"), "--no-plots", "--start", "1", "--until", "position"]
    assert run_cli(["replay", str(log.write(tmp_path / "log")), *arguments]) == 0
    assert "no reference is used: /mocap/pose" in capsys.readouterr().err
    assert set(read_table(tmp_path / "runs" / "log", "poses")["source"]) == {"odometry"}


def test_log_times_are_proposed_only_for_topics_that_are_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Log()
    for t_s in instants_s(2.0, 20):
        log.odometry(ns(t_s), Room(6.0).at(t_s))
    on_another_clock(log)
    log.tf(0, "base_link", "laser", (0.0, 0.0, 0.0), 0.1, "/tf_static")
    log.add("/chatter", ns(0.5), message("std_msgs/msg/String", "no stamp"))
    log.messages = [(max(t_ns, ns(0.0)), *rest) for t_ns, *rest in log.messages]
    assert run_cli(["info", str(log.write(tmp_path / "log"))]) == 0
    err = capsys.readouterr().err
    assert "header stamps of 1 topic lie" in err
    assert "--stamp log" not in err


def test_an_intact_log_of_nothing_that_is_used_is_nothing_to_replay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Log()
    log.add("/chatter", ns(0.0), message("std_msgs/msg/String", "hello"))
    assert run_cli(["replay", str(log.write(tmp_path / "log")), "-o", str(tmp_path / "runs")]) == 1
    err = capsys.readouterr().err
    assert "nothing to replay" in err
    assert "nothing readable" not in err


def test_a_run_that_was_not_asked_for_positions_does_not_blame_the_log(tmp_path: Path) -> None:
    log = Log()
    way(log)
    arguments = ["-o", str(tmp_path / "runs"), "--until", "ingest", "--no-plots"]
    assert run_cli(["replay", str(log.write(tmp_path / "log")), *arguments]) == 0
    page = (tmp_path / "runs" / "log" / "report.html").read_text()
    assert "Positions were not computed" in page
    assert "does not tell where the robot was" not in page
