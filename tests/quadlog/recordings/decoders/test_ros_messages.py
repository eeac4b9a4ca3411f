from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ros_messages import Definitions
from tests.lab.decoded import decoded


def test_embedded_definition_beats_the_standard_one(both_ros: Any) -> None:
    """A Range of another shape is read by the definition it brings, not by the one quadlog knows."""
    channel = Channel("/r", "sensor_msgs/msg/Range", "cdr", "ros2msg", b"uint32 other\nfloat32 range\n")
    message = Definitions().deserialiser(channel)(b"\0\1\0\0" + (7).to_bytes(4, "little") + b"\0\0\x80\x3f")
    assert (message.other, message.range) == (7, 1.0)


def test_msg_path_serves_types_that_the_recording_leaves_out(tmp_path: Path) -> None:
    folder = tmp_path / "custom_uwb" / "msg"
    folder.mkdir(parents=True)
    (folder / "Pair.msg").write_text("End first\nEnd second\n")
    (folder / "End.msg").write_text("uint8 id\n")
    channel = Channel("/pair", "custom_uwb/msg/Pair", "ros1", "", b"")
    with pytest.raises(DecodeError, match="--msg-path"):
        Definitions().deserialiser(channel)
    message = Definitions([tmp_path]).deserialiser(channel)(b"\3\4")
    assert (message.first.id, message.second.id) == (3, 4)


@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(3), b"\0\3\0\0" + bytes(60), bytes(4000)])
def test_payloads_that_do_not_fit_are_decode_errors(both_ros: Any, payload: bytes) -> None:
    channel = both_ros.cdr.channel("/odom", "nav_msgs/msg/Odometry")
    for decode in (lambda payload: decoded(channel, payload), Definitions().deserialiser(channel)):
        with pytest.raises(DecodeError, match="/odom"):
            decode(payload)
