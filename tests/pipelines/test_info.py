"""`info` and `init`: what is in a recording, by all of it or a sample, what is wrong with it, what to configure."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from numpy.testing import assert_allclose

from quadlog.cli.main import run as run_cli
from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.errors import QuadlogError
from quadlog.pipelines.info import describe_recording, propose_config
from quadlog.recordings.containers.container import EXCERPT
from quadlog.recordings.recording import open_recording
from quadlog.results.tables import read_table
from quadlog.storage.remote_path import to_path
from tests.lab.recordings import written
from tests.lab.strangers import ROS, START_NS, Log
from tests.pipelines.conftest import FIXTURES

TAGFRAME = b"\0\1\0\0\2\5" + bytes(2 + 4 + 4 + 4 + 36) + np.array([1.5, 0, 2.5, 0, 0, 0, 0, 0], "<f4").tobytes()
TAGFRAME += bytes(12 + 16 + 24)
POINT, NOWHERE = "geometry_msgs/msg/PointStamped", (1.0, 2.0, 0.0)
DATASETS = Path(os.environ.get("QUADLOG_DATASETS", "/nowhere"))
with_datasets = pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")


def test_the_whole_object(tmp_path):
    """Odometry on simulation time, header-less LinkTrack frames without definition, one of them cut short."""
    log, frames = Log(), []
    for i in range(12):
        t_ns = START_NS + i * 10**8
        log.put("/point", t_ns, POINT, header=ROS.header(47 * 10**9, ""))
        frames.append(("/uwb", t_ns, "nlink_parser/msg/LinktrackTagframe0", TAGFRAME[: -30 if i == 6 else None]))
    info = describe_recording(written(tmp_path / "walk.mcap", [*log.rows(), *frames], [POINT]), Config())
    assert json.loads(json.dumps(info, allow_nan=False)) == info
    assert (info["messages"], info["start_ns"], info["end_ns"]) == (24, START_NS, START_NS + 11 * 10**8)
    point, uwb = info["topics"]
    assert (point["name"], point["hz_min"]) == ("/point", pytest.approx(10))
    assert point["clock_offset_s"] == pytest.approx(47 - START_NS * 1e-9 - 0.55)
    assert (uwb["role"], uwb["messages"], uwb["clock_offset_s"]) == ("uwb", 12, None)
    assert [(each["cause"], each["topic"], each["count"]) for each in info["losses"]] == [("decode", "/uwb", 1)]
    assert [(each["tag"], each["anchor"], each["n"]) for each in info["links"]] == [(5, 0, 11), (5, 2, 11)]
    assert any("1 topic lie" in line and "--stamp log" not in line for line in info["warnings"])


def test_clocks_that_jump_go_back_or_stand_at_zero_are_warnings_but_not_of_static_transforms(tmp_path):
    log = Log()
    for i in range(1200):
        t_ns = START_NS + i * 10**7
        log.pose(t_ns + (172_800 * 10**9 if i >= 1100 else 0), NOWHERE, "/pose")
        log.pose(0, NOWHERE, "/mocap")
        log.odometry(t_ns + (1000 * 10**9 if i < 100 else 0), NOWHERE, "/odom")
        log.tf(t_ns + (900 * 10**9 if i < 100 else 0), "odom", "base", NOWHERE)
        log.tf((1 + i * 10**6) * 10**9, "base", "lidar", NOWHERE, topic="/tf_static")
        log.messages[-5:] = [(t_ns, *row[1:]) for row in log.messages[-5:]]
    info = describe_recording(log.write(tmp_path / "walk.mcap"), Config())
    assert info["losses"] == []
    jump, zero = sorted(line for line in info["warnings"] if "jump" in line or "stamp 0" in line)[::-1]
    assert jump == "/pose: header stamps jump by 172800 s against log time; take log times with  --stamp log"
    (back,) = (line for line in info["warnings"] if "go back" in line)
    assert back.startswith("/odom, /tf: header stamps go back by 999.99 s, to ")
    assert back.endswith("; take log times with  --stamp log")
    assert zero == "/mocap: 1200 messages have the stamp 0; their log time is used"


@pytest.mark.parametrize("command", [["info"], ["replay", "--until", "position", "-o"]])
@pytest.mark.parametrize(
    ("others", "lost"),
    [
        ([("/tf_static", "nav_msgs/msg/Odometry")], True),
        ([("/x", "std_msgs/msg/String"), ("/x", "nav_msgs/msg/Odometry")], True),
        ([("/x", "std_msgs/msg/String"), ("/x", "std_msgs/msg/Bool")], False),
    ],
)
def test_a_topic_of_several_types_is_a_loss_if_one_is_read(tmp_path, capsys, command, others, lost):
    log = Log()
    for _ in range(12):
        log.pose(1, NOWHERE, "/mocap")
        log.tf(1, "base", "lidar", NOWHERE, topic="/tf_static")
    path = written(tmp_path / "walk.mcap", [*log.rows(), *((topic, 10**8, name, b"") for topic, name in others)])
    runs = [str(tmp_path / "runs")] if "-o" in command else []
    assert run_cli([*command, *runs, str(path)]) == (3 if lost else 0)
    assert ("lost: " in (err := capsys.readouterr().err)) == ("carries several types" in err) == lost


@with_datasets
def test_real_files_are_described_or_refused_and_their_topics_have_a_role_or_a_reason():
    """Large files are left to tests of their own; every odd one is described or refused by name."""
    small = [path for path in sorted(DATASETS.rglob("*")) if path.suffix in (".mcap", ".bag", ".db3")]
    small = [path for path in small if path.stat().st_size < 3_000_000]
    alike = [path for path in small if "mcap_conformance" in path.parts]  # a test of the reader reads all of them
    seen = 0
    for path in {*small} - {*alike} | {*alike[::10]}:
        try:
            json.dumps(describe_recording(path, Config()), allow_nan=False)
            seen += 1
        except QuadlogError as error:
            assert path.name in str(error)  # noqa: PT017
    assert seen > 25
    several = "edge_cases/lidar_fields/several_pointcloud2_types.bag"
    for name in ("odometry/jackal_odom_imu.bag", several, "uwb_tiers/rosbag2_2022_09_07-17_25_41"):
        info = describe_recording(DATASETS / name, Config())
        assert [each["name"] for each in info["topics"] if not each["role"] and not each["why"]] == []


COUNT = EXCERPT.messages + 100


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """More messages than are read by default: a pose every 10 ms in chunks of about 50."""
    log = Log()
    log.pose(START_NS, NOWHERE, "/pose")
    ((topic, _, name, payload),) = log.rows()
    stamp = np.frombuffer(payload, np.uint8).copy()
    rows = []
    for t_ns in range(START_NS, START_NS + COUNT * 10**7, 10**7):
        stamp[4:12] = np.frombuffer(np.array([t_ns // 10**9, t_ns % 10**9], "<u4").tobytes(), np.uint8)
        rows.append((topic, t_ns, name, stamp.tobytes()))
    path = tmp_path_factory.mktemp("many") / "walk.mcap"
    return written(path, rows, chunk_size=5000, compression=CompressionType.NONE)


def test_a_large_recording_is_sampled_and_its_counts_are_whole(many, web):
    info, full = describe_recording(many, Config()), describe_recording(many, Config(), full=True)
    assert (info["sampled"], full["sampled"]) == (True, False)
    assert info["messages"] == full["messages"] == full["messages_read"] == COUNT
    assert 0 < info["messages_read"] < EXCERPT.messages / 10
    assert info | {"sampled": False, "messages_read": COUNT} == full
    size = (web.folder / many.name).write_bytes(many.read_bytes())
    assert describe_recording(to_path(f"{web.url}/{many.name}"), Config())["messages"] == COUNT
    assert web.sent_bytes < 0.9 * size  # of a remote one, index and sample


def test_damage_is_found_in_the_sample_or_by_full_and_makes_info_read_on_where_nothing_is_left(many, tmp_path):
    path, data = tmp_path / "damaged.mcap", bytearray(many.read_bytes())

    def damaged(*offsets: int) -> dict[str, Any]:
        for offset in offsets:
            data[offset] ^= 0xFF
        path.write_bytes(data)
        return describe_recording(path, Config())

    assert damaged(7000)["losses"] == []  # in the second of some hundred chunks
    assert [loss["cause"] for loss in describe_recording(path, Config(), full=True)["losses"]] == ["crc"]
    with open_recording(many) as recording:
        part = recording.excerpt(EXCERPT)
        offsets = [many.read_bytes().index(bytes(raw.payload)) for raw in part.container.messages()]
    info = damaged(7000, offsets[-1])
    assert (info["sampled"], [each["cause"] for each in info["losses"]]) == (True, ["crc"])
    info = damaged(*offsets[:-1])
    assert (info["sampled"], [each["cause"] for each in info["losses"]]) == (False, ["crc"])
    assert any("no message of the sample can be read" in line for line in info["warnings"])


@pytest.fixture(scope="module")
def follow():
    return describe_recording(FIXTURES / "follow.mcap", load_config(FIXTURES / "follow.toml"))


def test_links_are_those_of_a_replay(follow, whole_run):
    """Of the person's tag: the robot's track is steadied by odometry in a replay alone."""
    links = read_table(whole_run.run, "links")
    rows, person = [row for row in follow["uwb"] if row["tag"] == 1], links["tag"] == 1
    assert [(row["tag"], row["anchor"]) for row in follow["uwb"]] == [(t, a) for t in (0, 1) for a in range(4)]
    same = {"residual_m": "residual_rms_m", "nlos_share": "nlos_share"}
    same |= {name: name for name in ("bias_m", "bias_std_m", "bias_applied", "n")}
    for info, saved in same.items():
        assert_allclose([float(row[info]) for row in rows], links[saved][person].astype(float), err_msg=info)
    # Twelve seconds among walls: positions without one of the links agree much better with the biases.
    assert all((row["bias_applied"], row["why_not"]) == (True, "") for row in follow["uwb"])


def test_an_ellipse_is_its_hdop(follow):
    """For a fix with covariance C, trace(C) is (HDOP std)^2; the 95 % semi-axes are sqrt(5.991) times its roots."""
    assert json.loads(json.dumps(follow, allow_nan=False)) == follow
    robot, person = follow["uwb_tags"]
    assert [(tag["role"], tag["height_m"]) for tag in (robot, person)] == [("robot", 0.6), ("person", 1.3)]
    assert robot["fixes"] + robot["too_few_ranges"] + robot["degenerate"] == robot["epochs"] == 600
    from_axes = np.hypot(robot["ellipse_major_median_m"], robot["ellipse_minor_median_m"]) / np.sqrt(5.991)
    assert from_axes == pytest.approx(0.1 * robot["hdop_median"], rel=0.02)
    bare = describe_recording(FIXTURES / "follow.mcap", Config())
    assert (bare["uwb"], bare["uwb_tags"]) == ([], [])


@with_datasets
def test_what_init_proposes_for_real_logs_can_be_filled_in(tmp_path):
    """With its comments lifted it has every radio of the log; of sections only those that the log can use."""
    text = propose_config(DATASETS / "uwb_lias" / "lias_fast.mcap").text
    (tmp_path / "quadlog.toml").write_text(text)
    topics = load_config(tmp_path / "quadlog.toml").topics
    assert (topics.uwb, topics.reference) == (["/nlink_linktrack_tagframe0"], "/mocap/trolley/pose")
    head, skeleton = text.split("# The radios")
    keys = ("# [[", "# id", "# x_m", "# y_m", "# z_m", "# role", "# height_m")
    filled = skeleton.replace("_m = \n", "_m = 1.0\n").splitlines()
    lifted = "\n".join([head, *(line[2:] for line in filled if line.startswith(keys))])
    uwb = Config.model_validate(tomllib.loads(lifted)).uwb
    assert [anchor.id for anchor in uwb.anchors] == list(range(8))
    tags = [(tag.id, tag.role, tag.height_m) for tag in uwb.tags]
    assert tags == [(0, "robot", 0.6), (1, "person", 1.3), (2, "none", 0.6)]
    text = propose_config(DATASETS / "uwb_tiers" / "rosbag2_2022_09_07-17_25_41").text
    assert "# several could be it: /turtle01/odom  or  /turtle03/odom" in text
    assert "odometry" not in tomllib.loads(text)["topics"]
    odometry_only = DATASETS / "odometry" / "jackal_odom_imu.bag"
    text = propose_config(odometry_only).text
    assert set(tomllib.loads(text)) == {"topics", "results"}
    assert text.splitlines()[-1].startswith("# This log cannot use [uwb] [lidar]")
    assert set(tomllib.loads(propose_config(odometry_only, everything=True).text)) == set(Config.model_fields)
