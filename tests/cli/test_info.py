"""`quadlog info` and `quadlog init` on small recordings and on the committed one."""

from __future__ import annotations

import json
import re
import shlex
import sys
import tomllib
from pathlib import Path
from urllib.parse import unquote

import pytest

from quadlog.cli.info import info_lines
from quadlog.cli.progress import show
from quadlog.config.file import load_config
from quadlog.recordings.containers.container import EXCERPT
from tests.cli.conftest import FOLLOW
from tests.lab.recordings import written
from tests.lab.strangers import ROS

STRING = b"\0\1\0\0\1\0\0\0\0"
VICON = "string name\nfloat32 x_trans\nfloat32 y_trans\nfloat32 z_trans"
RANGE = b"\0\1\0\0" + b"".join(n.to_bytes(4, "little") for n in (4, 1, 2500, 0)) + bytes(16)


@pytest.fixture
def recording(tmp_path):
    messages = [("/chat\x1b[31mter", i * 10**9, "std_msgs/msg/String", STRING) for i in range(3)]
    return written(tmp_path / "walk.mcap", [*messages, ("/odom", 10**9, "nav_msgs/msg/Odometry", b"\0\1\0\0")])


@pytest.fixture
def ranging(tmp_path):
    return written(tmp_path / "walk.mcap", [("/gtec", 10**9, "gtec_msgs/msg/Ranging", RANGE)])


def test_text_or_one_object_on_stdout_losses_on_stderr_and_exit_code(recording, quadlog, refused):
    code, out, err = quadlog("info", recording)
    assert (code, "\x1b" in out + err) == (3, False)
    assert all(words in out for words in ("4 messages in 2.0 s", "std_msgs/msg/String", "1..1"))
    assert "lost: /odom: 1 messages could not be decoded" in err
    info = json.loads(quadlog("info", "--json", recording).out)
    assert {"path", "messages", "start_ns", "end_ns", "losses", "warnings", "topics"} <= set(info)
    assert {"name", "type", "messages", "hz_min", "hz_max", "gaps", "role", "why"} <= set(info["topics"][0])
    assert "/points is not in the recording" in refused(1, "info", recording, "--set", "topics.lidar=/points")


def test_flags_to_paste_settle_what_they_were_offered_for(tmp_path, quadlog):
    topics = ["/my odom; ls", "/odom'\x1b[31m"]
    messages = [(topic, 10**9, "nav_msgs/msg/Odometry", b"\0\1\0\0") for topic in topics]
    path = written(tmp_path / "walk.mcap", messages)
    _, out, err = quadlog("info", path)
    assert "\x1b" not in out + err
    (line,) = [line for line in out.splitlines() if line.startswith("2 topics could be the odometry")]
    flags = line.split("choose with  ")[1].split("  or  ")
    for flag, topic in zip(flags, topics, strict=True):
        info = json.loads(quadlog("info", "--json", path, *shlex.split(flag)).out)
        assert (info["roles"]["odometry"]["topics"], info["ambiguous"]) == ([topic], {})


def test_hints_make_topics_usable_that_are_not_read(tmp_path, quadlog):
    """Keys can be pasted, three topics' at most; JSON has all of them."""
    ROS.register(Position=VICON)
    messages = [(f"/vicon/{k}", 10**9, "own/msg/Position", bytes(32)) for k in range(4)]
    path = written(tmp_path / "walk.mcap", [*messages, ("/packets", 10**9, "velodyne_msgs/msg/VelodyneScan", b"")])
    out = quadlog("info", path).out
    hints = out[out.index("to use") : out.index("a replay will")]
    assert max(len(line) for line in out.splitlines() if line.startswith("    ")) <= 80
    assert "point clouds" in " ".join(out.split())
    keys = [line.strip() for line in hints.splitlines() if line.startswith(("    [[", "    topic ="))]
    assert keys == [line for k in range(3) for line in ("[[topics.poses]]", f'topic = "/vicon/{k}"')]
    assert "and 1 more, all of them in --json" in hints
    rows = {row["name"]: row["hint"] for row in json.loads(quadlog("info", "--json", path).out)["topics"]}
    assert tomllib.loads(rows["/vicon/3"])["topics"]["poses"][0]["fields"] == ["x_trans", "y_trans", "z_trans"]
    assert "velodyne_pointcloud" in rows["/packets"]


def test_a_sample_is_said_and_full_reads_all(tmp_path, quadlog):
    """Progress goes to stderr only, and not where that is no terminal."""
    messages = [("/chatter", i * 10**7, "std_msgs/msg/String", STRING) for i in range(EXCERPT.messages + 1)]
    path = written(tmp_path / "walk.mcap", messages, chunk_size=5000)
    for full, sampled in ([], True), (["--full"], False):
        code, out, err = quadlog("info", path, *full)
        assert (code, err, "--full reads all" in out) == (0, "", sampled)


def test_init_writes_a_config_that_loads_overwrites_none_and_reports_damage_as_info_does(
    ranging, tmp_path, monkeypatch, ok, quadlog, refused
):
    monkeypatch.chdir(tmp_path)
    assert ok("init", ranging) == "quadlog.toml\n"
    assert load_config(Path("quadlog.toml")).topics.uwb == ["/gtec"]
    text = Path("quadlog.toml").read_text()
    assert all(line in text for line in ("# id = 4\n", "# id = 1\n"))
    schema = re.match(r"#:schema (file://\S+)\n", text)[1]  # as Even Better TOML and taplo read it
    assert set(tomllib.loads(text)) <= set(json.loads(Path(unquote(schema[7:])).read_text())["properties"])
    Path("quadlog.toml").write_text("keep")
    assert "--force" in refused(1, "init", ranging)
    assert Path("quadlog.toml").read_text() == "keep"
    ok("init", ranging, "--force")
    assert Path("quadlog.toml").read_text() == text
    ranging.write_bytes(ranging.read_bytes()[:-30])
    info = quadlog("info", ranging)
    assert (info.code, "lost: " in info.err) == (3, True)
    assert quadlog("init", ranging, "--force") == (3, "quadlog.toml\n", info.err)


@pytest.fixture(scope="module")
def info():
    """The object of the committed recording."""
    from quadlog.pipelines.info import describe_recording

    return describe_recording(Path(FOLLOW[0]), load_config(Path(FOLLOW[2])))


def test_the_health_of_ranges_fits_a_terminal(info, monkeypatch, capsys):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    for width in (40, 60, 80):
        monkeypatch.setenv("COLUMNS", str(width))
        show("\n".join(info_lines(info | {"path": "follow.mcap"})))
        shown = capsys.readouterr().out
        assert "--set topics.target=/truth/person/pose" in shown, "a flag to paste is not broken"
        lines = shown.replace("--set ", "--set=").splitlines()
        assert [line for line in lines if len(line) > width and " " in line.strip()] == []
    at = next(at for at, line in enumerate(lines) if line.split()[:4] == ["tag", "anchor", "ranges", "residual"])
    link = lines[at + 1].split()
    row = info["uwb"][0]
    assert link[:3] == ["0", "0", str(row["n"])]
    assert float(link[3]) == pytest.approx(row["residual_m"], rel=1e-3)
    assert link[-1] == "applied"


def test_what_is_rejected_says_so_and_long_tables_are_cut(info):
    row = info["uwb"][0] | {"bias_applied": False, "why_not": "known to 0.09 m only"}
    text = "\n".join(info_lines(info | {"uwb": [row], "links": info["links"] * 10, "tf": info["tf"] * 9}))
    assert "not applied: known to 0.09 m only" in " ".join(text.split())
    assert "  and 40 more, all of them in --json\n" in text
