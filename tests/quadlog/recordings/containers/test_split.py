from __future__ import annotations

import resource
import tempfile
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter

from quadlog.errors import CannotWrite, RecordingNotFound
from quadlog.recordings.containers.open import open_container

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
def folder(tmp_path, recordings):
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
def test_all_files_are_one_recording(folder, recordings, with_metadata):
    if with_metadata:
        write_metadata(folder)
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert [(c.topic, c.count) for c in container.channels] == [("/b", 30), ("/a", 30)]
        assert (container.losses, container.warnings) == ([], [])


@pytest.mark.parametrize("with_metadata", [True, False])
def test_a_missing_split_is_named(folder, recordings, with_metadata):
    if with_metadata:
        write_metadata(folder)
    (folder / "bag_1.mcap").unlink()
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()[:20] + recordings.some()[40:]
        assert container.losses[0].cause == "missing-split"
        assert "bag_1" in container.losses[0].detail
        counts = {loss.topic: loss.count for loss in container.losses if loss.cause == "count"}
        assert counts == ({"/a": 10, "/b": 10} if with_metadata else {})


def test_an_unreadable_and_a_truncated_split_do_not_cost_the_others(folder, recordings):
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


def test_a_wrong_message_count_is_not_ignored(folder, recordings):
    write_metadata(folder, a=33, b=29)
    with open_container(folder) as container:
        assert len(recordings.read(container)) == 60
        (loss,) = container.losses
        assert (loss.cause, loss.topic, loss.count) == ("count", "/a", 3)
        assert container.warnings == ["/b: metadata.yaml says 29 messages, the files have 30"]


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
def test_broken_metadata_is_a_warning(folder, recordings, text):
    (folder / "metadata.yaml").write_text(text)
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert container.losses == []
        assert "metadata.yaml is broken" in container.warnings[0]
        assert len(container.warnings[0]) < 500


def test_metadata_of_many_topics_is_read(folder, recordings):
    write_metadata(folder)
    profiles = "".join(
        f"\n          - {{history: 3, depth: {n}, deadline: {{sec: 9223372036, nsec: 854775807}}}}" for n in range(5)
    )
    entry = """
    - topic_metadata:
        name: /of_another_part_{number}
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles:{profiles}
      message_count: 0"""
    text = (folder / "metadata.yaml").read_text()
    more = "".join(entry.format(number=number, profiles=profiles) for number in range(1000))
    (folder / "metadata.yaml").write_text(text.replace("\n  compression_format", more + "\n  compression_format"))
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert (container.losses, container.warnings) == ([], [])


def test_paths_that_lead_out_of_the_folder_are_not_followed(folder, recordings):
    outside = recordings.mcap(folder.parent / "secret.mcap", [("/secret", recordings.base_ns, b"x")])
    write_metadata(folder, ["bag_0.mcap", "../secret.mcap", str(outside), "bag_1.mcap", "bag_2.mcap"])
    with open_container(folder) as container:
        assert recordings.read(container) == recordings.some()
        assert container.losses[0].cause == "missing-split"
        assert "secret.mcap" in container.losses[0].detail


def test_files_missing_from_metadata_are_a_warning(folder, recordings):
    write_metadata(folder, ["bag_0.mcap", "bag_1.mcap"], a=20, b=20)
    recordings.mcap(folder / "bag_2.mcap", recordings.some()[40:])
    with open_container(folder) as container:
        assert len(recordings.read(container)) == 60
        assert "bag_2.mcap, read all the same" in container.warnings[0]
    (folder / "bag_2.mcap").rename(folder / "other.mcap")
    with open_container(folder) as container:
        assert len(recordings.read(container)) == 40
        assert "other.mcap not read" in container.warnings[0]


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_what_rosbags_writes_is_read(tmp_path, recordings, plugin, mode):
    messages = recordings.some()
    folder = tmp_path / "bag"
    writer = FolderWriter(folder, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, recordings.type_name, msgdef="string data", rihs01="RIHS01_0")
            for topic in ("/b", "/a")
        }
        for topic, t_ns, payload in messages:
            writer.write(connections[topic], t_ns, payload)
    before = sorted(path.name for path in folder.iterdir())
    with open_container(folder) as container:
        assert recordings.read(container) == messages
        assert (container.losses, container.warnings) == ([], [])
        assert sorted(path.name for path in folder.iterdir()) == before


SKIPPABLE_FRAME = b"\x50\x2a\x4d\x18\x04\0\0\0size"


def in_frames(data, count=3):
    """As pzstd compresses: several frames, with one that decoders skip before each."""
    size = -(-len(data) // count)
    parts = (data[begin : begin + size] for begin in range(0, len(data), size))
    return b"".join(SKIPPABLE_FRAME + zstandard.compress(part) for part in parts)


@pytest.mark.parametrize("compress", [zstandard.compress, in_frames])
@pytest.mark.parametrize("build", ["mcap", "bag", "db3"])
def test_a_compressed_file_is_read_alone(tmp_path, recordings, compress, build):
    packed = tmp_path / f"b.{build}.zstd"
    packed.write_bytes(compress(getattr(recordings, build)(tmp_path / "a", recordings.some()).read_bytes()))
    with open_container(packed) as container:
        assert recordings.read(container) == recordings.some()
        assert (container.path, container.losses, container.warnings) == (packed, [], [])


@pytest.mark.parametrize("damage", [lambda data: data[:-300], lambda data: data[:-300] + bytes(300)])
def test_a_compressed_file_is_read_until_its_damage(tmp_path, recordings, damage):
    path = recordings.mcap(tmp_path / "a.mcap", recordings.some())
    packed = tmp_path / "b.mcap.zstd"
    packed.write_bytes(damage(in_frames(path.read_bytes())))
    with open_container(packed) as container:
        got = recordings.read(container)
        assert 0 < len(got) < 60
        assert got == recordings.some()[: len(got)]
        assert set(recordings.causes(container)) == {"truncated"}
        assert "compressed data is damaged" in container.warnings[0]


def test_decompressing_without_room_names_the_file_and_the_folder(tmp_path, recordings, limited):
    packed = tmp_path / "b.mcap.zst"
    packed.write_bytes(zstandard.compress(recordings.mcap(tmp_path / "a.mcap", recordings.some()).read_bytes()))
    limited(resource.RLIMIT_FSIZE, 1000)
    with pytest.raises(CannotWrite, match=rf"{packed}: .*{tempfile.gettempdir()}.*TMPDIR"):
        open_container(packed)


def test_a_folder_without_files_or_with_separate_recordings_is_not_one(folder, tmp_path):
    (folder / "another.mcap").write_bytes((folder / "bag_0.mcap").read_bytes())
    for each in (folder, tmp_path):
        with pytest.raises(RecordingNotFound):
            open_container(each)


@pytest.mark.parametrize("name", ["split_no_metadata_mcap", "split_no_metadata_sqlite3", "wbag_mcap", "wbag_sqlite3"])
def test_real_splits_are_whole(edge_cases, recordings, name):
    with open_container(edge_cases / "rosbag2" / name) as container:
        got = recordings.read(container)
        assert len(got) == (6074 if name.startswith("wbag") else 3177) == sum(c.count for c in container.channels)
        assert [m[1] for m in got] == sorted(m[1] for m in got)
        assert (container.losses, container.warnings) == ([], [])


def test_a_serialization_named_only_by_metadata_is_a_warning(edge_cases, recordings):
    with open_container(edge_cases / "rosbag2" / "wrong_serialization") as container:
        assert all("'wrong_format'" in warning for warning in container.warnings)
        assert len(container.warnings) == 2


@pytest.mark.parametrize("build", ["mcap", "bag", "db3"])
def test_a_recording_of_many_files_holds_few_of_them_open(tmp_path, recordings, limited, build):
    (tmp_path / "bag").mkdir()
    messages = recordings.some(40)
    for number, message in enumerate(messages):
        getattr(recordings, build)(tmp_path / "bag" / f"bag_{number}.{build}", [message])
    limited(resource.RLIMIT_NOFILE, len(list(Path("/proc/self/fd").iterdir())) + 10)
    with open_container(tmp_path / "bag") as container:
        for _ in range(2):  # a file that was released is opened again
            begun = container.messages()
            assert recordings.read_one(next(begun)) == messages[0]
            assert recordings.read(container) == messages
            assert [recordings.read_one(message) for message in begun] == messages[1:]
        assert container.losses == []
