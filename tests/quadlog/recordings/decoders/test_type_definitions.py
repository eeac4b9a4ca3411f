from __future__ import annotations

from dataclasses import replace

import pytest

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ranges import own_ranges
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoders.type_definitions import LARGEST_DEFINITION_BYTES
from tests.lab.decoded import decoded


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
    with pytest.raises(DecodeError):
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
