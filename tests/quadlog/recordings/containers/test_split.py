from __future__ import annotations

import resource
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter

from quadlog.errors import TooLarge
from quadlog.recordings.containers.open import open_container
from tests.lab import recordings

METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  relative_file_paths: [{files}]
  message_count: {total}
  topics_with_message_count:
    - topic_metadata: {{name: /a, type: std_msgs/msg/String, serialization_format: cdr, offered_qos_profiles: ""}}
      message_count: {a}
    - topic_metadata: {{name: /b, type: std_msgs/msg/String, serialization_format: cdr, offered_qos_profiles: ""}}
      message_count: {b}
  compression_format: ""
  compression_mode: ""
"""


@pytest.fixture
def folder(tmp_path):
    """Three files of 20 messages each, no metadata."""
    folder = tmp_path / "bag"
    folder.mkdir()
    messages = recordings.some()
    for number in range(3):
        recordings.mcap(folder / f"bag_{number}.mcap", messages[20 * number : 20 * number + 20])
    return folder


def write_metadata(folder, files=("bag_0.mcap", "bag_1.mcap", "bag_2.mcap"), a=30, b=30):
    text = METADATA.format(files=", ".join(f'"{name}"' for name in files), total=a + b, a=a, b=b)
    (folder / "metadata.yaml").write_text(text)


@pytest.mark.parametrize("with_metadata", [True, False])
def test_all_files_are_one_recording(folder, with_metadata):
    if with_metadata:
        write_metadata(folder)
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert [(c.topic, c.count) for c in container.channels] == [("/b", 30), ("/a", 30)]
        assert (container.losses, container.warnings) == ([], [])


@pytest.mark.parametrize("with_metadata", [True, False])
def test_a_missing_split_is_named(folder, with_metadata):
    if with_metadata:
        write_metadata(folder)
    (folder / "bag_1.mcap").unlink()
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()[:20] + recordings.some()[40:]
        assert container.losses[0].cause == "missing-split"
        assert "bag_1" in container.losses[0].detail
        counts = {loss.topic: loss.count for loss in container.losses if loss.cause == "count"}
        assert counts == ({"/a": 10, "/b": 10} if with_metadata else {})


def test_an_unreadable_and_a_truncated_split_do_not_cost_the_others(folder):
    """Losses within a file carry its name."""
    (folder / "bag_1.mcap").write_bytes(b"")
    path = folder / "bag_2.mcap"
    path.write_bytes(path.read_bytes()[:-300])
    with open_container(folder) as container:
        assert recordings.read(container)[:20] == recordings.some()[:20]
        first, *others = container.losses
        assert first.cause == "missing-split"
        assert "bag_1.mcap: the file is empty" in first.detail
        assert others
        assert all(loss.detail.startswith("bag_2.mcap: ") for loss in others)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- a",
        "rosbag2_bagfile_information: 3",
        *(f"rosbag2_bagfile_information: {{message_count: {each}}}" for each in ("many", ".inf", "1e300", "9" * 10**5)),
        "rosbag2_bagfile_information: {relative_file_paths: [[a]]}",
        "rosbag2_bagfile_information: {compression_format: " + "a" * 100_000 + "}",
        "rosbag2_bagfile_information: {topics_with_message_count: [{topic_metadata: {name: {}}}]}",
        "rosbag2_bagfile_information: {topics_with_message_count: [{topic_metadata: {name: " + "a" * 10**6 + "}}]}",
        *(each * (10**6 // len(each)) for each in ("[", "a: [", "a: b\n")),
    ],
    ids=lambda text: repr(text[:40]),
)
def test_broken_metadata_is_a_warning(folder, text):
    (folder / "metadata.yaml").write_text(text)
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert container.losses == []
        assert "metadata.yaml is broken" in container.warnings[0]
        assert len(container.warnings[0]) < 500


def test_paths_that_lead_out_of_the_folder_are_not_followed(folder):
    outside = recordings.mcap(folder.parent / "secret.mcap", [("/secret", recordings.BASE_NS, b"x")])
    write_metadata(folder, ["bag_0.mcap", "../secret.mcap", str(outside), "bag_1.mcap", "bag_2.mcap"])
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert container.losses[0].cause == "missing-split"
        assert "secret.mcap" in container.losses[0].detail


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_what_rosbags_writes_is_read(tmp_path, plugin, mode):
    messages = recordings.some()
    folder = tmp_path / "bag"
    writer = FolderWriter(folder, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, recordings.TYPE_NAME, msgdef="string data", rihs01="RIHS01_0")
            for topic in ("/b", "/a")
        }
        for topic, t_ns, payload in messages:
            writer.write(connections[topic], t_ns, payload)
    before = sorted(path.name for path in folder.iterdir())
    with open_container(folder) as container:
        assert recordings.read(container) == messages
        assert (container.losses, container.warnings) == ([], [])
        assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize("build", [recordings.mcap, recordings.bag, recordings.db3])
def test_a_compressed_file_is_read_alone_and_until_its_damage(tmp_path, build):
    """As pzstd compresses: several frames, with one that decoders skip before each."""
    data = build(tmp_path / "a", recordings.some()).read_bytes()
    third = len(data) // 3
    parts = (data[:third], data[third : 2 * third], data[2 * third :])
    frames = b"".join(b"\x50\x2a\x4d\x18\x04\0\0\0size" + zstandard.compress(part) for part in parts)
    path = tmp_path / "b.zstd"
    path.write_bytes(frames)
    with open_container(path) as container:
        assert recordings.read(container) == recordings.some()
        assert (container.path, container.losses, container.warnings) == (path, [], [])
    if build is not recordings.db3:
        path.write_bytes(frames[:-300] + bytes(300))
        with open_container(path) as container:
            got = recordings.read(container)
            assert 0 < len(got) < 60
            assert got == recordings.some()[: len(got)]
            assert "truncated" in recordings.causes(container)


@pytest.mark.parametrize("name", ["split_no_metadata_mcap", "split_no_metadata_sqlite3", "wbag_mcap", "wbag_sqlite3"])
def test_real_splits_are_whole(edge_cases, name):
    with open_container(edge_cases / "rosbag2" / name) as container:
        got = recordings.read(container)
        assert len(got) == (6074 if name.startswith("wbag") else 3177) == sum(c.count for c in container.channels)
        assert [m[1] for m in got] == sorted(m[1] for m in got)
        assert (container.losses, container.warnings) == ([], [])


@pytest.mark.parametrize("build", ["mcap", "bag", "db3"])
def test_a_recording_of_more_files_than_may_be_open_raises_that_limit(tmp_path, limited, monkeypatch, build):
    (tmp_path / "bag").mkdir()
    messages = recordings.some(40)
    for number, message in enumerate(messages):
        getattr(recordings, build)(tmp_path / "bag" / f"bag_{number}.{build}", [message])
    limited(resource.RLIMIT_NOFILE, len(list(Path("/proc/self/fd").iterdir())) + 10)
    with open_container(tmp_path / "bag") as container:
        for _ in range(2):
            begun = container.messages()
            assert recordings.read_one(next(begun)) == messages[0]
            assert recordings.read(container) == messages
            assert [recordings.read_one(message) for message in begun] == messages[1:]
        assert container.losses == []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (100, 100))
    with pytest.raises(TooLarge, match="bag: open files: 104 exceeds the limit of 100"):
        open_container(tmp_path / "bag")
