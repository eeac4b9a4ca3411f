from __future__ import annotations

import json
import os
import shlex
from pathlib import Path

import pytest
from mcap.writer import Writer

from quadlog.cli.main import run
from quadlog.recordings.containers.container import EXCERPT


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


def test_a_file_that_may_not_be_read_is_no_wrong_usage(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Permissions do not stop an administrator, so the refusal is played, as click and as quadlog see it."""
    really = Path.open

    def refuse(path: Path, *arguments: object, **options: object) -> object:
        if path == recording:
            raise PermissionError(13, "Permission denied", str(path))
        return really(path, *arguments, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    monkeypatch.setattr(Path, "open", refuse)
    for command in (["info", str(recording)], ["init", str(recording), "-o", str(tmp_path / "new.toml")]):
        assert run(command) == 1
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert "walk.mcap" in err
        assert "not allowed to read it" in err


def test_flags_to_paste_settle_what_they_were_offered_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "walk.mcap"
    topics = ["/my odom; ls", "/odom'\x1b[31m"]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", b"")
        for topic in topics:
            writer.add_message(writer.register_channel(topic, "cdr", schema), 10**9, b"\0\1\0\0", 10**9)
        writer.finish()
    run(["info", str(path)])
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    (line,) = [line for line in out.splitlines() if line.startswith("2 topics could be the odometry")]
    flags = line.split("choose with  ")[1].split("  or  ")
    for flag, topic in zip(flags, topics, strict=True):
        run(["info", "--json", str(path), *shlex.split(flag)])
        info = json.loads(capsys.readouterr().out)
        assert info["roles"]["odometry"]["topics"] == [topic]
        assert info["ambiguous"] == {}


def test_a_sample_is_said_and_full_reads_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Progress goes to stderr alone, and not where that is no terminal."""
    path = tmp_path / "walk.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=5000)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        for i in range(EXCERPT.messages + 1):
            writer.add_message(channel, i * 10**7, b"\0\1\0\0\1\0\0\0\0", i * 10**7)
        writer.finish()
    assert run(["info", str(path)]) == 0
    out, err = capsys.readouterr()
    (line,) = [line for line in out.splitlines() if line.startswith("sampled: ")]
    assert "--full reads all" in line
    assert f"{EXCERPT.messages + 1} messages" in out
    assert run(["info", str(path), "--full"]) == 0
    out, full_err = capsys.readouterr()
    assert "sampled" not in out
    assert err + full_err == ""
