from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoding import decoder_for


def as_it_is(message: Any, _: str) -> Any:
    return message


def test_embedded_definition_beats_the_standard_one(both_ros: Any) -> None:
    """A Range of another shape is read by the definition it brings, not by the one quadlog knows."""
    channel = Channel("/r", "sensor_msgs/msg/Range", "cdr", "ros2msg", b"uint32 other\nfloat32 range\n")
    message = Definitions().decoder(channel, as_it_is)(b"\0\1\0\0" + (7).to_bytes(4, "little") + b"\0\0\x80\x3f")
    assert (message.other, message.range) == (7, 1.0)


def test_msg_path_serves_types_that_the_recording_leaves_out(tmp_path: Path) -> None:
    folder = tmp_path / "custom_uwb" / "msg"
    folder.mkdir(parents=True)
    (folder / "Pair.msg").write_text("End first\nEnd second\n")
    (folder / "End.msg").write_text("uint8 id\n")
    channel = Channel("/pair", "custom_uwb/msg/Pair", "ros1", "", b"")
    with pytest.raises(DecodeError, match="--msg-path"):
        Definitions().decoder(channel, as_it_is)
    message = Definitions([tmp_path]).decoder(channel, as_it_is)(b"\3\4")
    assert (message.first.id, message.second.id) == (3, 4)


@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(3), b"\0\3\0\0" + bytes(60), bytes(4000)])
def test_payloads_that_do_not_fit_are_decode_errors(both_ros: Any, payload: bytes) -> None:
    decode = decoder_for(both_ros.cdr.channel("/odom", "nav_msgs/msg/Odometry"))
    assert decode is not None
    with pytest.raises(DecodeError, match="/odom"):
        decode(payload)


def test_big_endian_payloads_are_read(both_ros: Any) -> None:
    ros = both_ros.cdr
    payload = ros.serialise(ros.odometry(5, 1.25), big_endian=True)
    (odometry,) = decoder_for(ros.channel("/odom", "nav_msgs/msg/Odometry"))(payload)  # type: ignore[misc]
    assert odometry.position_m[0] == 1.25  # type: ignore[union-attr]


def test_unknown_encodings_are_refused_by_name() -> None:
    for name in ("sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"):
        with pytest.raises(DecodeError, match="'cbor'"):
            decoder_for(Channel("/x", name, "cbor", "", b""))


def test_types_without_use_have_no_decoder() -> None:
    assert decoder_for(Channel("/chatter", "std_msgs/msg/String", "cdr", "ros2msg", b"string data")) is None


def test_broken_embedded_definition_is_refused(both_ros: Any) -> None:
    channel = Channel("/odom", "nav_msgs/msg/Odometry", "cdr", "ros2msg", b"Nonsense !!")
    with pytest.raises(DecodeError, match="cannot be parsed"):
        decoder_for(channel)
