from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from quadlog.cli.info import dilution_lines, link_table, reach_lines, tag_lines
from quadlog.config.file import load_config
from quadlog.recordings.containers.container import EXCERPT

FIXTURES = Path(__file__).parents[2] / "fixtures"
STRING = b"\0\1\0\0\1\0\0\0\0"
SCHEMAS = {
    "std_msgs/msg/String": b"string data",
    "nav_msgs/msg/Odometry": b"",
    "gtec_msgs/msg/Ranging": b"",
}
RANGE = b"\0\1\0\0" + b"".join(n.to_bytes(4, "little") for n in (4, 1, 2500, 0)) + bytes(16)

Messages = list[tuple[str, str, int, bytes]]


def write(path: Path, messages: Messages, **options: Any) -> Path:
    """A recording of messages: topic, type, time, payload."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        schemas = {kind: writer.register_schema(kind, "ros2msg", text) for kind, text in SCHEMAS.items()}
        channels: dict[str, int] = {}
        for topic, kind, t_ns, payload in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schemas[kind])
            writer.add_message(channels[topic], t_ns, payload, t_ns)
        writer.finish()
    return path


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    messages: Messages = [("/chat\x1b[31mter", "std_msgs/msg/String", i * 10**9, STRING) for i in range(3)]
    return write(tmp_path / "walk.mcap", [*messages, ("/odom", "nav_msgs/msg/Odometry", 10**9, b"\0\1\0\0")])


@pytest.fixture
def ranging(tmp_path: Path) -> Path:
    return write(tmp_path / "walk.mcap", [("/gtec", "gtec_msgs/msg/Ranging", 10**9, RANGE)])


def test_table_on_stdout_losses_on_stderr_and_exit_code(recording: Path, quadlog: Callable[..., Any]) -> None:
    code, out, err = quadlog("info", recording)
    assert code == 3
    for words in ("4 messages in 2.0 s", "std_msgs/msg/String", "1..1"):
        assert words in out
    assert "\x1b" not in out + err
    assert "lost: /odom: 1 messages could not be decoded" in err


def test_json_is_one_object(recording: Path, quadlog: Callable[..., Any]) -> None:
    info = json.loads(quadlog("info", "--json", recording).out)
    assert {"path", "messages", "start_ns", "end_ns", "losses", "warnings", "topics"} <= set(info)
    assert {"name", "type", "messages", "hz_min", "hz_max", "gaps", "role", "why"} <= set(info["topics"][0])


def test_errors_are_one_line(tmp_path: Path, recording: Path, refused: Callable[..., str]) -> None:
    assert "absent.mcap" in refused(1, "info", tmp_path / "absent.mcap")
    assert "/points is not in the recording" in refused(1, "info", recording, "--set", "topics.lidar=/points")


def test_a_file_that_may_not_be_read_is_no_wrong_usage(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    """Permissions do not stop an administrator, so the refusal is simulated, as click and as quadlog see it."""
    really = Path.open

    def refuse(path: Path, *arguments: object, **options: object) -> object:
        if path == recording:
            raise PermissionError(13, "Permission denied", str(path))
        return really(path, *arguments, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    monkeypatch.setattr(Path, "open", refuse)
    for command in (["info", recording], ["init", recording, "-o", tmp_path / "new.toml"]):
        assert "walk.mcap" in refused(1, *command)


def test_flags_to_paste_settle_what_they_were_offered_for(tmp_path: Path, quadlog: Callable[..., Any]) -> None:
    topics = ["/my odom; ls", "/odom'\x1b[31m"]
    messages: Messages = [(topic, "nav_msgs/msg/Odometry", 10**9, b"\0\1\0\0") for topic in topics]
    path = write(tmp_path / "walk.mcap", messages)
    _, out, err = quadlog("info", path)
    assert "\x1b" not in out + err
    (line,) = [line for line in out.splitlines() if line.startswith("2 topics could be the odometry")]
    flags = line.split("choose with  ")[1].split("  or  ")
    for flag, topic in zip(flags, topics, strict=True):
        info = json.loads(quadlog("info", "--json", path, *shlex.split(flag)).out)
        assert info["roles"]["odometry"]["topics"] == [topic]
        assert info["ambiguous"] == {}


def test_a_sample_is_said_and_full_reads_all(tmp_path: Path, quadlog: Callable[..., Any]) -> None:
    """Progress goes to stderr only, and not where that is no terminal."""
    messages: Messages = [("/chatter", "std_msgs/msg/String", i * 10**7, STRING) for i in range(EXCERPT.messages + 1)]
    path = write(tmp_path / "walk.mcap", messages, chunk_size=5000)
    code, out, err = quadlog("info", path)
    assert (code, err) == (0, "")
    (line,) = [line for line in out.splitlines() if line.startswith("sampled: ")]
    assert "--full reads all" in line
    assert f"{EXCERPT.messages + 1} messages" in out
    code, out, err = quadlog("info", path, "--full")
    assert (code, err, "sampled" in out) == (0, "", False)


def test_init_writes_a_config_that_loads(
    ranging: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ok: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert ok("init", ranging) == "quadlog.toml\n"
    assert load_config(Path("quadlog.toml")).topics.uwb == ["/gtec"]
    text = Path("quadlog.toml").read_text()
    assert "# id = 4\n" in text
    assert "# id = 1\n" in text


def test_init_refuses_to_overwrite(
    ranging: Path, tmp_path: Path, ok: Callable[..., str], refused: Callable[..., str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("keep")
    assert "--force" in refused(1, "init", ranging, "-o", path)
    assert path.read_text() == "keep"
    ok("init", ranging, "-o", path, "--force")
    assert path.read_text() != "keep"


def test_init_reports_damage_as_info_does(ranging: Path, tmp_path: Path, quadlog: Callable[..., Any]) -> None:
    ranging.write_bytes(ranging.read_bytes()[:-30])
    info = quadlog("info", ranging)
    assert info.code == 3
    assert "lost: " in info.err
    output = tmp_path / "new.toml"
    assert quadlog("init", ranging, "-o", output) == (3, f"{output}\n", info.err)
    assert load_config(output).topics.uwb == ["/gtec"]


LINK: dict[str, Any] = {"tag": 0, "anchor": 3, "n": 584, "residual_m": 0.241, "residual_median_m": -0.0736}
LINK |= {"bias_m": -0.023, "bias_std_m": 0.087, "bias_applied": False, "why_not": "known to 0.09 m only"}
LINK |= {"nlos_share": 0.0749, "weak_first_path_share": None}
REACH: dict[str, Any] = {"topic": "/uwb", "tag": 2, "anchor": 3, "n": 10, "range_min_m": 1.0, "range_max_m": 7.256}
TAG: dict[str, Any] = {"tag": 2, "role": "robot", "epochs": 600, "fixes": 590, "too_few_ranges": 8, "degenerate": 2}
TAG |= {"hdop_median": 1.034, "ellipse_major_median_m": 0.199, "ellipse_minor_median_m": 0.156, "reference": "/truth"}
TAG |= {"fix_error": {"rmse_m": 0.342, "bias_x_m": 0.003, "bias_y_m": -0.153, "share_in_ellipse": 0.599, "nees": 9.34}}
TAG |= {"track_error": None, "nis": 0.514, "calibration": "why they are applied"}


def test_a_rejected_bias_says_why_and_an_applied_one_that_it_is() -> None:
    none = LINK | {"bias_m": None, "bias_std_m": None, "why_not": "calibration is off"}
    _, (rejected, applied, off) = link_table([LINK, LINK | {"bias_applied": True, "why_not": ""}, none])
    assert rejected[:6] == ["0", "3", "584", "0.241", "-0.074", "7.5 %"]
    assert rejected[6:] == ["-0.023 +- 0.087", "not applied: known to 0.09 m only"]
    assert applied[-1] == "applied"
    assert off[-2:] == ["", "not applied: calibration is off"]


def test_first_paths_have_a_column_only_where_a_radio_tells() -> None:
    columns, _ = link_table([LINK])
    assert "weak path" not in columns
    columns, rows = link_table([LINK, LINK | {"weak_first_path_share": 0.125}])
    assert [row[columns.index("weak path")] for row in rows] == ["", "12.5 %"]
    assert {len(row) for row in rows} == {len(columns)}


def test_a_tag_says_what_it_claims_and_what_the_reference_says() -> None:
    claims = "median HDOP 1.03, median 95 % semi-axes 0.199 x 0.156 m"
    assert list(tag_lines(TAG)) == [
        f"tag 2 (robot): 590 fixes in 600 epochs (8 with too few ranges, 2 degenerate); {claims}",
        "  normalised innovation squared 0.51 per range (1 where uwb.range_std_m is right)",
        "  biases: why they are applied",
        "  fixes against /truth: RMSE 0.342 m, bias (+0.003, -0.153) m, 59.9 % in their 95 % ellipses, NEES 9.3",
    ]
    nothing = {"role": None, "fixes": 0, "too_few_ranges": 600, "degenerate": 0, "hdop_median": None, "fix_error": None}
    nothing |= {"nis": None, "calibration": "why they are not"}
    assert list(tag_lines(TAG | nothing)) == [
        "tag 2: 0 fixes in 600 epochs (600 with too few ranges)",
        "  biases: why they are not",
    ]


def test_the_map_has_north_up_and_its_axes_at_the_cells_middles() -> None:
    place = {"origin_x_m": -3.0, "origin_y_m": 1.5, "cell_m": 1.5, "tag_height_m": 0.6}
    head, *lines = dilution_lines(place | {"hdop": [[0.7, 1.0, None], [12.0, 0.75, 2.0]]})
    assert head.startswith("HDOP")
    assert lines == [
        " y m",
        "3.75 |   >10  0.75  2.00",
        "2.25 |  0.70  1.00     -",
        "     +------------------",
        " x m   -2.25 -0.75  0.75",
    ]


def test_info_prints_all_of_it(ok: Callable[..., str]) -> None:
    out = ok("info", FIXTURES / "follow.mcap", "-c", FIXTURES / "follow.toml")
    assert out.count("  applied") == 8
    assert out.count("30% is needed") == 2
    claims = ("tag 0 (robot): 598 fixes in 600 epochs", "track against /truth/robot/pose: RMSE")
    for words in (*claims, "HDOP", " y m", " x m"):
        assert words in out, words
    assert max(len(line) for line in out[out.index("HDOP (") :].splitlines()) < 80


def test_a_log_whose_tags_hear_too_little_still_says_so(ok: Callable[..., str]) -> None:
    """Only one of the three configured anchors is in the log."""
    anchors = ", ".join(f"{{id={i}, x_m={x}, y_m={y}, z_m=1.0}}" for i, x, y in ((0, 1.0, 1.0), (11, 9, 0), (12, 0, 9)))
    out = ok("info", FIXTURES / "follow.mcap", "--set", f"uwb.anchors=[{anchors}]")
    assert "with too few ranges" in out
    assert "residual m" not in out


def test_each_link_has_a_line_until_there_are_too_many() -> None:
    none = REACH | {"anchor": 4, "range_min_m": None, "range_max_m": None}
    one, other = reach_lines([REACH, none])
    assert one == "  /uwb  tag 2  anchor 3  10 ranges  1.00..7.26 m"
    assert other.startswith("  /uwb  tag 2  anchor 4  10 ranges  no")
    assert len(list(reach_lines([REACH] * 40))) == 40
    *lines, last = reach_lines([REACH] * 43)
    assert len(lines) == 40
    assert last == "  and 3 more links, all of them in --json"
