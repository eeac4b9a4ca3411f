from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zlib
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import DataEnd, Footer
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from quadlog.errors import NotARun
from quadlog.results import load_maps, read_table
from quadlog.results.derived_mcap import write_derived
from quadlog.results.layout import write_layout
from quadlog.results.schemas import TABLES
from quadlog.results.tables import write_table

START_NS = 1_700_000_000_123_456_789


@pytest.fixture
def messages(tiny_run: Path) -> dict[str, list[tuple[int, Any]]]:
    """(log time, decoded message) by topic, every chunk's checksum verified."""
    found = defaultdict(list)
    with (tiny_run / "derived.mcap").open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _schema, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                found[channel.topic].append((message.log_time, json.loads(message.data)))
        for _schema, channel, message, decoded in reader.iter_decoded_messages(topics=sorted(set(TOPICS) - NUMBERS)):
            assert message.publish_time == message.log_time
            found[channel.topic].append((message.log_time, decoded))
    return found


TOPICS = {
    "/quadlog/tf": ("foxglove.FrameTransform", 40),
    "/quadlog/pose": ("foxglove.PoseInFrame", 40),
    "/quadlog/target": ("foxglove.PoseInFrame", 40),
    "/quadlog/uwb/fix/0": ("foxglove.PoseInFrame", 40),
    "/quadlog/uwb/fix/1": ("foxglove.PoseInFrame", 39),
    "/quadlog/map": ("foxglove.Grid", 40),
    "/quadlog/plan": ("quadlog.Plan", 40),
    "/quadlog/path": ("foxglove.PosesInFrame", 40),
    "/quadlog/path_smooth": ("foxglove.PosesInFrame", 40),
    "/quadlog/resim/pose": ("foxglove.PoseInFrame", 200),
    "/quadlog/resim/error": ("quadlog.Tracking", 200),
    "/quadlog/resim/path": ("foxglove.PosesInFrame", 40),
    "/quadlog/resim/path_smooth": ("foxglove.PosesInFrame", 40),
    "/quadlog/metrics": ("foxglove.Log", 2),
}
NUMBERS = {"/quadlog/plan", "/quadlog/resim/error"}


def test_topics_schemas_and_counts(tiny_run: Path) -> None:
    with (tiny_run / "derived.mcap").open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    found = {
        channel.topic: (summary.schemas[channel.schema_id].name, counts[channel.id])
        for channel in summary.channels.values()
    }
    assert found == TOPICS
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert summary.statistics.message_start_time == START_NS


def test_data_and_summary_checksums_hold(tiny_run: Path) -> None:
    content = (tiny_run / "derived.mcap").read_bytes()
    with (tiny_run / "derived.mcap").open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    footer = records[-1]
    assert isinstance(footer, Footer)
    ends = [record for record in records if isinstance(record, DataEnd)]
    data_end = footer.summary_start - (1 + 8 + 4)
    assert ends[0].data_section_crc == zlib.crc32(content[:data_end])
    covered = content[footer.summary_start : -(4 + 8)]
    assert footer.summary_crc == zlib.crc32(covered)
    assert struct.unpack("<I", content[-12:-8])[0] == footer.summary_crc


def test_times_are_the_tables_and_in_order(tiny_run: Path, messages: Any) -> None:
    poses = read_table(tiny_run, "poses")
    assert [t for t, _ in messages["/quadlog/pose"]] == poses["t_ns"].tolist()
    control = read_table(tiny_run, "control")
    assert [t for t, _ in messages["/quadlog/resim/error"]] == control["t_ns"].tolist()
    with (tiny_run / "derived.mcap").open("rb") as file:
        stored = [message.log_time for *_, message in SeekingReader(file).iter_messages(log_time_order=False)]
    assert stored == sorted(stored)


def test_poses_and_transforms_say_what_the_tables_say(tiny_run: Path, messages: Any) -> None:
    poses = read_table(tiny_run, "poses")
    for i, (t_ns, message) in enumerate(messages["/quadlog/pose"]):
        assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == t_ns
        assert message.frame_id == "map"
        assert (message.pose.position.x, message.pose.position.y) == (poses["x_m"][i], poses["y_m"][i])
        quat = message.pose.orientation
        assert 2 * np.arctan2(quat.z, quat.w) == pytest.approx(poses["yaw_rad"][i])
    last = messages["/quadlog/tf"][-1][1]
    assert (last.parent_frame_id, last.child_frame_id) == ("map", "base")
    assert (last.translation.x, last.translation.y) == (poses["x_m"][-1], poses["y_m"][-1])
    assert messages["/quadlog/uwb/fix/0"][0][1].pose.position.z == 0.6
    assert messages["/quadlog/resim/pose"][0][1].pose.position.z == 0.0  # a kinematic robot has no height


def test_grids_are_the_maps(tiny_run: Path, messages: Any) -> None:
    for (t_ns, grid), (map_t_ns, origin_m, occupied) in zip(messages["/quadlog/map"], load_maps(tiny_run), strict=True):
        assert t_ns == map_t_ns
        assert (grid.pose.position.x, grid.pose.position.y) == tuple(origin_m)
        assert (grid.column_count, grid.row_stride, grid.cell_stride, grid.cell_size.x) == (50, 50, 1, 0.1)
        assert [(field.name, field.offset, field.type) for field in grid.fields] == [("occupied", 0, 1)]
        np.testing.assert_array_equal(np.frombuffer(grid.data, np.uint8).reshape(60, 50), occupied)


def test_paths_hold_the_points_there_are(tiny_run: Path, messages: Any) -> None:
    paths = read_table(tiny_run, "paths")
    for k, (t_ns, message) in enumerate(messages["/quadlog/path"]):
        rows = slice(10 * k, 10 * k + 10)
        assert paths["t_ns"][rows].tolist() == [t_ns] * 10
        assert [pose.position.x for pose in message.poses] == paths["x_m"][rows].tolist()
        assert len(messages["/quadlog/path_smooth"][k][1].poses) == 8


def test_numbers_and_metrics(messages: Any) -> None:
    first = {"found": 1.0, "expanded": 20.0, "generated": 60.0, "cost": 200.0, "length_m": 2.0}
    assert messages["/quadlog/plan"][0][1] == {**first, "from_scratch": 1.0, "us": 40.0}
    assert "cost" not in messages["/quadlog/plan"][5][1]  # no path was found
    assert messages["/quadlog/resim/error"][0][1]["lookahead_m"] == 2.0
    assert [(t, line.message) for t, line in messages["/quadlog/metrics"]] == [
        (START_NS, "eta_m = 0.123 m (n = 200)"),
        (START_NS, "fallen = 0 (n = 1)"),
    ]


def test_the_bytes_do_not_depend_on_the_process(tiny_run: Path) -> None:
    written = (tiny_run / "derived.mcap").read_bytes()
    script = (
        "import foxglove; foxglove.Channel('/other', message_encoding='json')\n"
        f"from pathlib import Path\nfrom quadlog.results.derived_mcap import write_derived\n"
        f"write_derived(Path({str(tiny_run)!r}))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env={**os.environ, "PYTHONHASHSEED": "7"})
    assert (tiny_run / "derived.mcap").read_bytes() == written


def test_a_run_of_nothing_but_positions(tiny_run: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tiny_run / "poses.parquet").rename(tmp_path / "run" / "poses.parquet")
    write_derived(tmp_path / "run")
    with (tmp_path / "run" / "derived.mcap").open("rb") as file:
        assert {channel.topic for _, channel, _ in SeekingReader(file).iter_messages()} == {
            "/quadlog/tf",
            "/quadlog/pose",
        }


@pytest.mark.parametrize("t_ns", [-1, (1 << 32) * 10**9])
def test_a_time_that_foxglove_cannot_show_is_refused(tmp_path: Path, t_ns: int) -> None:
    pose = {"t_ns": [t_ns], "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0, "source": "uwb"}
    write_table(tmp_path / "poses.parquet", TABLES["poses"], pose)
    with pytest.raises(NotARun, match="before 1970 or after 2106"):
        write_derived(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["poses.parquet"]


def test_a_damaged_table_stops_it_whole(write_run: Callable[[Path], Path], tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    (run / "derived.mcap").unlink()
    (run / "plans.parquet").write_bytes(b"PAR1")
    with pytest.raises(NotARun, match=r"plans\.parquet"):
        write_derived(run)
    assert not (run / "derived.mcap").exists()
    assert not [name for name in [each.name for each in run.iterdir()] if name.startswith(".")]


def test_the_layout_shows_topics_that_are_written(tiny_run: Path) -> None:
    layout = json.loads(write_layout(tiny_run).read_bytes())
    panels = layout["configById"]
    assert set(panels["3D!scene"]["topics"]) <= set(TOPICS) | {f"/quadlog/uwb/fix/{tag}" for tag in range(8)}
    assert panels["Log!metrics"]["topicToRender"] == "/quadlog/metrics"
    shown = {each["value"] for name in panels if name.startswith("Plot!") for each in panels[name]["paths"]}
    assert {"/quadlog/plan.expanded", "/quadlog/resim/error.error_m"} <= shown
    assert {value.partition(".")[0] for value in shown} <= set(TOPICS)

    def placed(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else placed(node["first"]) + placed(node["second"])

    assert sorted(placed(layout["layout"])) == sorted(panels)
