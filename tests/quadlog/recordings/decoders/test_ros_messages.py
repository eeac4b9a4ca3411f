"""Messages by the definitions that recordings embed, or leave out, and definitions that cannot be used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ranges import own_ranges
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoders.type_definitions import LARGEST_DEFINITION_BYTES
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


def fields_of(text: str, size: int = 0, encoding: str = "ros2msg", name: str = "pkg/msg/A") -> list[str]:
    """Of a message of so many zeros."""
    ros1 = encoding == "ros1msg"
    read = Definitions().deserialiser(Channel("/a", name, "ros1" if ros1 else "cdr", encoding, text.encode()))
    return [field for field in vars(read(b"\0\1\0\0" * (not ros1) + bytes(size))) if not field.startswith("__")]


IDL = """
module pkg { module msg {
  @verbatim (language="comment", text="a (nested (thing)) << here")
  struct A { double x; sequence<float, 3> y; };
}; };
"""
MSG = "B b\nfloat32 x # metres\nstring NAME=import os\n" + "=" * 80 + "\nMSG: pkg/B\nint8 c\n"


def test_a_definition_with_its_parts_and_idl():
    assert fields_of(MSG, 8) == ["b", "x"]
    assert fields_of(MSG.replace("\n", "\r\n"), 8) == ["b", "x"]  # as some writers have it
    assert fields_of(IDL, 12, "ros2idl") == ["x", "y"]


def idl(constant: str, members: str) -> str:
    return f"module pkg {{ module msg {{ const int64 X = {constant}; struct A {{ {members} }}; }}; }};"


LINE = "\n" + "=" * 80 + "\n"


def parts(*texts: str) -> str:
    """The first text, and the others as types A0, A1, ..."""
    return LINE.join([texts[0], *(f"MSG: pkg/A{i}\n{text}" for i, text in enumerate(texts[1:]))])


@pytest.mark.parametrize(
    ("text", "encoding", "why"),
    [
        ("B b\n", "ros2msg", "missing"),
        ("A a\nA b\n", "ros2msg", "contains itself"),
        ("bool[0] s\n", "ros2msg", "array of 0"),
        (parts(*(f"A{i} a\nA{i} b\n" for i in range(28)), "bool a\n"), "ros1msg", "values"),
        (parts(*(f"A{i}[] a\nA{i}[] b\n" for i in range(28)), "bool a\n"), "ros1msg", "values"),
        ("float32 x\n!!! ???\n", "ros2msg", "parsed"),
        ("x" * (LARGEST_DEFINITION_BYTES + 1), "ros2msg", "larger"),
        ("".join(f"bool x{i}\n" for i in range(50_000)), "ros1msg", "longer than any message"),
        ("string x " + "a" * 100_000 + "\n", "ros1msg", "longer than any message"),
        ("table A {}", "flatbuffer", "flatbuffer"),
        *((idl(each, "double x;"), "ros2idl", "computed constants") for each in ("1 << 9999", "((1))", "9" * 40)),
        *(
            (idl("1", member * 500), "ros2idl", "longer than any message")
            for member in ("long x;", "sequence<" * 99 + "long" + ">" * 99 + " x;", "long x" + "[2]" * 99 + ";")
        ),
    ],
)
def test_unusable_definitions_are_refused(text, encoding, why):
    with pytest.raises(DecodeError, match=why):
        fields_of(text, encoding=encoding)


@pytest.mark.parametrize("opened", ["/*", '"\\', "@a(", '@a("', "struct a{", "@"])
def test_repeated_openings_are_parsed_in_linear_time(opened):
    with pytest.raises(DecodeError):
        fields_of(opened * (900_000 // len(opened)), encoding="ros2idl")


@pytest.mark.parametrize("name", ["pkg/msg/A'); import os #", "A", "../../etc/passwd", "pkg/msg/A\n"])
def test_names_that_are_no_identifiers_are_refused(name):
    """rosbags makes Python of them."""
    with pytest.raises(DecodeError, match="is no type name"):
        fields_of("int8 x\n", name=name)


MILLION = (1 + (1 << 20)).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("text", "payload"),
    [
        (parts("pkg/A0[] a\n", ""), MILLION),
        (parts("pkg/A0[] a\n", "A1 a\nA1[7] b\n", "uint8 X=1\n"), MILLION),
        (parts("pkg/A0[] a\n", "bool x\n"), MILLION + bytes(1 << 20)),
        (parts("string[] a\n"), MILLION + bytes(5 << 20)),
        ("string[1000000000] s\n", bytes(100)),
        ("uint8[1000000000] s\n", bytes(100)),
    ],
)
def test_a_payload_of_more_values_than_memory_should_hold_is_not_read(text: str, payload: bytes) -> None:
    """As an object, for plug-ins, and by columns, beside a field that is wanted."""
    channel = Channel("/p", "pkg/msg/A", "ros1", "ros1msg", text.encode())
    with pytest.raises(DecodeError, match=r"more fields|middle of a field"):
        Definitions().deserialiser(channel)(payload)
    channel = replace(channel, schema=b"float64 range\n" + channel.schema)
    with pytest.raises(DecodeError, match=r"more fields|middle of a field|larger"):
        decoded(channel, bytes(8) + payload, mapped={"/p": own_ranges(field="range")})
