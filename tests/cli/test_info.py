from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from quadlog.cli.main import run


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "walk.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        odometry = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", b"")
        chatter = writer.register_channel("/chat\x1b[31mter", "cdr", text)
        broken = writer.register_channel("/odom", "cdr", odometry)
        for i in range(3):
            writer.add_message(chatter, i * 10**9, b"\0\1\0\0\1\0\0\0\0", i * 10**9)
        writer.add_message(broken, 10**9, b"\0\1\0\0", 10**9)
        writer.finish()
    return path


def test_table_on_stdout_losses_on_stderr_and_exit_code(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(recording)]) == 3
    out, err = capsys.readouterr()
    assert "4 messages in 2.0 s" in out
    assert "std_msgs/msg/String" in out
    assert "1..1" in out
    assert "\x1b" not in out + err
    assert "lost: /odom: 1 messages could not be decoded" in err


def test_json_is_one_object(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", "--json", str(recording)]) == 3
    info = json.loads(capsys.readouterr().out)
    assert {"path", "messages", "start_ns", "end_ns", "losses", "warnings", "topics"} <= set(info)
    assert {"name", "type", "messages", "hz_min", "hz_max", "gaps", "role", "why"} <= set(info["topics"][0])


def test_errors_are_one_line(tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(tmp_path / "absent.mcap")]) == 1
    assert run(["info", str(recording), "--set", "topics.lidar=/points"]) == 1
    err = capsys.readouterr().err
    assert "absent.mcap" in err
    assert "/points is not in the recording" in err
    assert err.count("\n") == 2
