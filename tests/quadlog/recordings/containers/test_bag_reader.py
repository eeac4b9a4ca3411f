from __future__ import annotations

import struct

import pytest
from rosbags.rosbag1 import Reader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import get_types_from_msg

from quadlog.errors import NothingReadable
from quadlog.recordings.containers.open import open_container
from quadlog.recordings.recording import open_recording
from tests.lab import recordings
from tests.lab.messages import Ros


def chunk_offsets(path):
    with Reader(path) as reader:
        return [info.pos for info in reader.chunk_infos]


@pytest.mark.parametrize("compression", ["", "lz4", "bz2"])
def test_a_bag_without_index_is_recovered_whole(tmp_path, compression):
    messages = recordings.some()
    path = recordings.unindex(recordings.bag(tmp_path / "a.bag.active", messages, compression))
    with open_container(path) as container:
        assert recordings.read(container) == messages
        assert recordings.causes(container) == ["index"]
        assert sum(channel.count for channel in container.channels) == len(messages)


def test_messages_of_a_chunk_that_was_never_closed_are_recovered(tmp_path):
    messages = recordings.some()
    path = recordings.bag(tmp_path / "a.bag.active", messages)
    last = chunk_offsets(path)[-1]
    data = bytearray(recordings.unindex(path).read_bytes())
    # roscpp writes the chunk's sizes when it closes it; until then both are zero.
    (header_length,) = struct.unpack_from("<I", data, last)
    size = data.index(b"size=", last) + len(b"size=")
    body = last + 4 + header_length + 4
    (body_length,) = struct.unpack_from("<I", data, body - 4)
    struct.pack_into("<I", data, size, 0)
    struct.pack_into("<I", data, body - 4, 0)
    path.write_bytes(bytes(data[: body + body_length - 30]))
    with open_container(path) as container:
        got = recordings.read(container)
        assert got == messages[: len(got)]
        assert messages.index(got[-1]) == len(messages) - 2
        assert recordings.causes(container) == ["index", "truncated"]


def test_publishers_of_one_topic_are_one_channel_and_two_types_are_two(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        for caller, type_name in (("/n1", "std_msgs/msg/String"), ("/n2", "std_msgs/msg/String"), ("/n3", "a/msg/B")):
            md5sum = str(len(type_name)) * 16
            connection = writer.add_connection("/a", type_name, msgdef="x", md5sum=md5sum, callerid=caller)
            writer.write(connection, 5, caller.encode())
    with open_container(path) as container:
        assert [(c.type_name, c.count) for c in container.channels] == [("std_msgs/msg/String", 2), ("a/msg/B", 1)]
        assert [bytes(m.payload) for m in container.messages()] == [b"/n1", b"/n2", b"/n3"]


def test_an_encrypted_bag_is_refused(tmp_path):
    path = recordings.bag(tmp_path / "a.bag", recordings.some())
    head = recordings.bag_record(b"", op=b"\3", index_pos=bytes(8), encryptor=b"rosbag/AesCbcEncryptor")
    path.write_bytes(b"#ROSBAG V2.0\n" + head)
    with pytest.raises(NothingReadable, match="encrypted"):
        open_container(path)


@pytest.mark.parametrize("name", ["example", "example-lz4", "example-bz2", "example-unsorted-chunks", "no-messages"])
def test_real_bags_read_as_rosbags_reads_them(edge_cases, name):
    path = edge_cases / "rosbag1" / f"{name}.bag"
    with Reader(path) as reader:
        theirs = [(connection.topic, t_ns, data) for connection, t_ns, data in reader.messages()]
    with open_container(path) as container:
        assert recordings.read(container) == theirs
        assert container.losses == []
        assert bool(container.warnings) == (name == "example-unsorted-chunks")


def test_transforms_under_both_names_of_ros_1_are_one_topic(tmp_path):
    ros, path, names = Ros("ros1"), tmp_path / "a.bag", ["tf/msg/tfMessage", "tf2_msgs/msg/TFMessage"]
    ros.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", names[0]))
    with BagWriter(path) as bag:
        for number, name in enumerate(names):
            message = ros.make(name, transforms=[ros.transform(10**9, "odom", "base", (1, 0, 0))])
            bag.write(bag.add_connection("/tf", name, typestore=ros.store), 10**9 + number, ros.serialise(message))
    with open_recording(path) as recording:
        assert recording.types_of("/tf") == ["tf2_msgs/msg/TFMessage"]
        assert len(list(recording.messages("/tf"))) == 2
        assert recording.losses == []
