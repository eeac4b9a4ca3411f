from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_typestore

from quadlog.cli.main import run
from quadlog.config.schema import Config
from quadlog.errors import QuadlogError
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.info import describe_recording
from quadlog.recordings.containers.container import EXCERPT
from quadlog.recordings.recording import open_recording
from quadlog.recordings.roles import why_not_read
from quadlog.storage.remote_path import to_path

T0 = 1_700_000_000 * 10**9
TAGFRAME = b"\0\1\0\0\2\5" + bytes(2 + 4 + 4 + 4 + 36) + np.array([1.5, 0, 2.5, 0, 0, 0, 0, 0], "<f4").tobytes()
TAGFRAME += bytes(12 + 16 + 24)


STORE = get_typestore(Stores.ROS2_HUMBLE)
MAKE: dict[str, Callable[..., Any]] = STORE.types
Row = tuple[str, str, bytes, int]
"""Topic, type, payload and log time of a message."""


def encoded(message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def header(stamp_ns: int, frame_id: str = "map") -> Any:
    return MAKE["std_msgs/msg/Header"](
        MAKE["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9), frame_id
    )


def pose(stamp_ns: int) -> bytes:
    place = MAKE["geometry_msgs/msg/Pose"](
        MAKE["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), MAKE["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    return encoded(MAKE["geometry_msgs/msg/PoseStamped"](header(stamp_ns), place))


def still(stamp_ns: int) -> bytes:
    """A static transform."""
    turn, shift = (
        MAKE["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        MAKE["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.4),
    )
    inner = MAKE["geometry_msgs/msg/Transform"](shift, turn)
    transform = MAKE["geometry_msgs/msg/TransformStamped"](header(stamp_ns, "base"), "lidar", inner)
    return encoded(MAKE["tf2_msgs/msg/TFMessage"]([transform]))


def write(path: Path, rows: Iterable[Row], definitions: Mapping[str, bytes] = {}, **settings: Any) -> Path:
    """An MCAP of the rows; without definitions but those given."""
    with path.open("wb") as file:
        writer, channels = Writer(file, **settings), {}
        writer.start()
        for topic, name, payload, t_ns in rows:
            if (topic, name) not in channels:
                schema = writer.register_schema(name, "ros2msg", definitions.get(name, b""))
                channels[topic, name] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic, name], t_ns, payload, t_ns)
        writer.finish()
    return path


POINT, POSE, TF = "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Odometry on simulation time, header-less LinkTrack frames without definition, one of them cut short."""
    point = encoded(MAKE[POINT](header(47 * 10**9), MAKE["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)))
    rows: list[Row] = []
    for i in range(12):
        t_ns = T0 + i * 10**8
        frame = TAGFRAME[:-30] if i == 6 else TAGFRAME
        rows += [("/point", POINT, point, t_ns), ("/uwb", "nlink_parser/msg/LinktrackTagframe0", frame, t_ns)]
    text = STORE.generate_msgdef(POINT, ros_version=2)[0].encode()
    return write(tmp_path / "walk.mcap", rows, {POINT: text})


def test_the_whole_object(recording: Path) -> None:
    info = describe_recording(recording, Config())
    assert json.loads(json.dumps(info, allow_nan=False)) == info
    assert (info["messages"], info["start_ns"], info["end_ns"]) == (24, T0, T0 + 11 * 10**8)
    point, uwb = info["topics"]
    assert point["name"] == "/point"
    assert point["hz_min"] == pytest.approx(10)
    assert point["clock_offset_s"] == pytest.approx(47 - T0 * 1e-9 - 0.55)
    assert (uwb["role"], uwb["messages"], uwb["clock_offset_s"]) == ("uwb", 12, None)
    assert [(each["cause"], each["topic"], each["count"]) for each in info["losses"]] == [("decode", "/uwb", 1)]
    assert [(each["tag"], each["anchor"], each["n"]) for each in info["links"]] == [(5, 0, 11), (5, 2, 11)]
    assert any("1 topic lie" in line and "--stamp log" not in line for line in info["warnings"])


def test_jumping_clocks_are_a_warning_and_no_error(tmp_path: Path) -> None:
    """Where a replay would stop; but a static transform may be of any age."""
    rows: list[Row] = []
    for i in range(1200):
        t_ns = T0 + i * 10**7
        rows.append(("/pose", POSE, pose(t_ns + (172_800 * 10**9 if i >= 1100 else 0)), t_ns))
        if i in (0, 1199):
            rows.append(("/tf_static", TF, still((1 + i * 10**6) * 10**9), t_ns))
    info = describe_recording(write(tmp_path / "walk.mcap", rows), Config())
    (jump,) = [line for line in info["warnings"] if "jump" in line]
    assert jump == "/pose: its header stamps jump by 172800 s against log time; take log times with  --stamp log"
    assert info["losses"] == []


def write_poses(path: Path, stamp_ns: int, *others: tuple[str, str]) -> Path:
    """Twelve poses of a reference and of static tf, all at one time, and a message of each other (topic, type)."""
    rows = [("/mocap", POSE, pose(stamp_ns), 10**8), ("/tf_static", TF, still(stamp_ns), 10**8)] * 12
    return write(path, [*rows, *((topic, name, b"", 10**8) for topic, name in others)])


@pytest.mark.parametrize(("stamp_ns", "warned"), [(0, True), (1, False)])
def test_stamps_of_zero_are_a_warning_but_for_static_transforms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], stamp_ns: int, warned: bool
) -> None:
    path = str(write_poses(tmp_path / "walk.mcap", stamp_ns))
    assert run(["info", path]) == 0
    line = "warning: /mocap: 12 messages have the stamp 0; their log time is used\n"
    assert capsys.readouterr().err == (line if warned else "")


@pytest.mark.parametrize("command", [["info"], ["replay", "--until", "position", "-o"]])
@pytest.mark.parametrize(
    ("others", "lost"),
    [
        ([("/tf_static", "nav_msgs/msg/Odometry")], "/tf_static: cannot be decoded: the topic carries several types"),
        ([("/x", "std_msgs/msg/String"), ("/x", "nav_msgs/msg/Odometry")], "/x: cannot be decoded: the topic carries"),
        ([("/x", "std_msgs/msg/String"), ("/x", "std_msgs/msg/Bool")], None),
    ],
)
def test_a_topic_of_several_types_is_a_loss_whatever_its_role(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str], others: list, lost: str | None
) -> None:
    path = str(write_poses(tmp_path / "walk.mcap", 1, *others))
    runs = [str(tmp_path / "runs")] if "-o" in command else []
    code = run([*command, *runs, path])
    err = capsys.readouterr().err
    assert code == (3 if lost else 0), err
    assert ("lost: " in err) == bool(lost)
    assert (lost or "") in err


def recordings_of_datasets() -> list[Path]:
    folder = os.environ.get("QUADLOG_DATASETS")
    return [] if not folder else [p for p in sorted(Path(folder).rglob("*")) if p.suffix in (".mcap", ".bag", ".db3")]


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_no_real_file_makes_it_fail_in_an_unknown_way() -> None:
    """Large files are left to the tests of their own; here every odd one must be described or refused in words."""
    seen = 0
    for path in recordings_of_datasets():
        if path.stat().st_size > 3_000_000:
            continue
        try:
            json.dumps(describe_recording(path, Config()), allow_nan=False)
            seen += 1
        except QuadlogError as error:
            assert path.name in str(error)  # noqa: PT017
    assert seen > 100


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_packets_are_named() -> None:
    path = Path(os.environ["QUADLOG_DATASETS"]) / "edge_cases" / "lidar_fields" / "packets_only.db3"
    (topic,) = describe_recording(path, Config())["topics"]
    assert topic["name"] == "/robosense_packets"
    assert "driver packets" in topic["why"]


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """More messages than are read unasked: a pose every 10 ms in chunks of about 50."""
    times_ns = [T0 + i * 10**7 for i in range(EXCERPT.messages + 100)]
    path = tmp_path_factory.mktemp("many") / "walk.mcap"
    rows = (("/pose", POSE, pose(t_ns), t_ns) for t_ns in times_ns)
    return write(path, rows, chunk_size=5000, compression=CompressionType.NONE)


def test_a_large_recording_is_sampled_and_its_counts_are_whole(many: Path) -> None:
    info, full = describe_recording(many, Config()), describe_recording(many, Config(), full=True)
    assert (info["sampled"], full["sampled"]) == (True, False)
    assert info["messages"] == full["messages"] == full["messages_read"] == EXCERPT.messages + 100
    assert 0 < info["messages_read"] < EXCERPT.messages / 10
    of_sample = ("sampled", "messages_read")
    assert {k: v for k, v in info.items() if k not in of_sample} == {
        k: v for k, v in full.items() if k not in of_sample
    }


def test_a_damaged_chunk_outside_the_sample_is_found_by_full(many: Path, tmp_path: Path) -> None:
    path = tmp_path / "damaged.mcap"
    data = bytearray(many.read_bytes())
    data[7000] ^= 0xFF  # in the second of some hundred chunks
    path.write_bytes(data)
    assert describe_recording(path, Config())["losses"] == []
    (loss,) = describe_recording(path, Config(), full=True)["losses"]
    assert (loss["cause"], "1 chunk with" in loss["detail"]) == ("crc", True)


def test_damage_inside_the_sample_is_told_and_all_of_it_makes_info_read_on(many: Path, tmp_path: Path) -> None:
    with open_recording(many) as recording:
        part = recording.excerpt(EXCERPT)
        assert part is not None
        offsets = [many.read_bytes().index(bytes(raw.payload)) for raw, _ in part.everything()]
    path = tmp_path / "damaged.mcap"
    data = bytearray(many.read_bytes())
    data[offsets[-1]] ^= 0xFF
    path.write_bytes(data)
    info = describe_recording(path, Config())
    assert (info["sampled"], [each["cause"] for each in info["losses"]]) == (True, ["crc"])
    for offset in offsets[:-1]:
        data[offset] ^= 0xFF
    path.write_bytes(data)
    info = describe_recording(path, Config())
    assert (info["sampled"], [each["cause"] for each in info["losses"]]) == (False, ["crc"])
    assert any("no message of the sample can be read" in line for line in info["warnings"])


def test_without_message_indexes_all_is_read_and_said(many: Path, tmp_path: Path) -> None:
    with many.open("rb") as source:
        rows = (("/pose", POSE, message.data, message.log_time) for *_, message in make_reader(source).iter_messages())
        path = write(tmp_path / "bare.mcap", rows, index_types=IndexType.ALL & ~IndexType.MESSAGE)
    steps = Steps()
    info = describe_recording(path, Config(), open_progress=lambda: nullcontext(steps))
    assert (info["sampled"], info["messages_read"]) == (False, EXCERPT.messages + 100)
    (warning,) = [line for line in info["warnings"] if "index" in line]
    assert "list 0 of" in warning
    assert "all of the recording was read" in warning
    assert (steps.total, steps.done) == (100, 100)


class Steps(Silent):
    """How far a progress bar would have come."""

    def __init__(self) -> None:
        self.total: int | None = None
        self.done = 0

    def begin(self, stage: str, total: int | None) -> None:
        self.total = total

    def advance(self, recorded_s: float | None = None) -> None:
        self.done += 1


def test_of_a_remote_recording_the_index_and_the_sample_are_fetched(many: Path, web: Any) -> None:
    size = (web.folder / many.name).write_bytes(many.read_bytes())
    info = describe_recording(to_path(f"{web.url}/{many.name}"), Config())
    assert (info["sampled"], info["messages"]) == (True, EXCERPT.messages + 100)
    assert web.sent_bytes < 0.9 * size


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
@pytest.mark.parametrize(
    "name",
    [
        "odometry/jackal_odom_imu.bag",
        "edge_cases/lidar_fields/several_pointcloud2_types.bag",
        "uwb_tiers/rosbag2_2022_09_07-17_25_41",
    ],
)
def test_every_topic_of_a_real_recording_has_a_role_or_a_reason(name: str) -> None:
    info = describe_recording(Path(os.environ["QUADLOG_DATASETS"]) / name, Config())
    assert [each["name"] for each in info["topics"] if not each["role"] and not each["why"]] == []


@pytest.mark.parametrize(
    ("type_name", "why"),
    [
        ("sensor_msgs/msg/CompressedImage", "not used: quadlog reads no camera images"),
        ("unitree_hg/msg/LowState", "not used: quadlog has no decoder for LowState"),
        ("my_msgs/msg/Gripper", "not used: quadlog has no decoder for Gripper"),
    ],
)
def test_a_type_that_is_not_read_is_told_in_plain_words(type_name: str, why: str) -> None:
    assert why_not_read(type_name) == why
