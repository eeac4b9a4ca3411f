from __future__ import annotations

import math

import pytest

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.type_definitions import (
    LARGEST_DEFINITION_BYTES,
    MOST_VALUES,
    BadDefinition,
    largest_payload_bytes,
    needed_types,
    parse_definition,
)
from quadlog.recordings.decoding import decoder_for


def fields_of(text: str, name: str = "pkg/msg/A", encoding: str = "ros2msg") -> list[str]:
    types = parse_definition(text.encode(), name, encoding)
    return [field for field, _ in needed_types(types, name, lambda _: {})[name][1]]


def test_a_definition_with_its_parts() -> None:
    text = "B b\nfloat32 x # metres\nstring NAME=import os\n" + "=" * 80 + "\nMSG: pkg/B\nint8 c\n"
    assert fields_of(text) == ["b", "x"]
    types = parse_definition(text, "pkg/msg/A", "ros2msg")
    assert all(constants == [] for constants, _ in needed_types(types, "pkg/msg/A", lambda _: {}).values())

    assert fields_of("B b\r\n=====\r\nMSG: pkg/B\r\nint8 c\r\n") == ["b"]  # as some writers have it


def test_idl() -> None:
    text = """
    module pkg { module msg {
      @verbatim (language="comment", text="a (nested (thing)) << here")
      struct A { double x; sequence<float, 3> y; };
    }; };
    """
    assert fields_of(text, encoding="ros2idl") == ["x", "y"]


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
        ("string[1000000000] s\n", "ros2msg", "elements of fixed arrays"),
        ("bool[0] s\n", "ros2msg", "array of 0"),
        (parts(*(f"A{i} a\nA{i} b\n" for i in range(28)), "bool a\n"), "ros1msg", "values"),
        (parts(*(f"A{i}[] a\nA{i}[] b\n" for i in range(28)), "bool a\n"), "ros1msg", "values"),
        ("float32 x\n!!! ???\n", "ros2msg", "parsed"),
        ("x" * (LARGEST_DEFINITION_BYTES + 1), "ros2msg", "larger"),
        ("table A {}", "flatbuffer", "flatbuffer"),
        *((idl(each, "double x;"), "ros2idl", "computed constants") for each in ("1 << 9999", "((1))", "9" * 40)),
        *(
            (idl("1", member * 500), "ros2idl", "longer than any message")
            for member in ("long x;", "sequence<" * 99 + "long" + ">" * 99 + " x;", "long x" + "[2]" * 99 + ";")
        ),
    ],
)
def test_unusable_definitions_are_refused(text: str, encoding: str, why: str) -> None:
    with pytest.raises(BadDefinition, match=why):
        fields_of(text, encoding=encoding)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (parts("A0[] a\n", ""), "no bytes"),
        (parts("A0[] a\n", "A1 a\nA1[7] b\n", "uint8 X=1\n"), "no bytes"),
        (parts("A0[99] a\n", "A1[99] a\n", "A2[99] a\n", "bool a\n"), "values"),
        (parts("A0[4096] a\n", "bool a\n"), "too many types, fields and elements"),
        ("".join(f"bool x{i}\n" for i in range(900)), "too many types, fields and elements"),
        ("".join(f"bool x{i}\n" for i in range(50_000)), "longer than any message"),
        ("string x " + "a" * 100_000 + "\n", "longer than any message"),
    ],
)
def test_a_definition_that_costs_more_than_any_message_is_refused(text: str, why: str) -> None:
    with pytest.raises(BadDefinition, match=why):
        largest_payload_bytes(needed_types(parse_definition(text, "pkg/msg/A", "ros1msg"), "pkg/msg/A", lambda _: {}))


@pytest.mark.parametrize("opened", ["/*", '"\\', "@a(", '@a("', "struct a{", "@"])
def test_repeated_openings_are_parsed_in_linear_time(opened: str) -> None:
    with pytest.raises(BadDefinition):
        fields_of(opened * (900_000 // len(opened)), encoding="ros2idl")


@pytest.mark.parametrize(
    ("text", "bytes_per_value"),
    [
        ("bool x\n", math.inf),
        ("uint8[] x\n", math.inf),
        ("string[] x\n", 4),
        (parts("A0[] a\n", "bool x\n"), 1 / 2),
        (parts("A0[] a\n", "A1[] a\n", "float64 x\n"), 2),  # an inner one of 4 bytes is A0 and its list
        (parts("A0[] a\n", "A1[3] a\nfloat64[36] b\n", ""), 288 / 5),
    ],
)
def test_payloads_are_bounded_by_the_values_they_may_hold(text: str, bytes_per_value: float) -> None:
    types = needed_types(parse_definition(text, "pkg/msg/A", "ros1msg"), "pkg/msg/A", lambda _: {})
    assert largest_payload_bytes(types) == MOST_VALUES * bytes_per_value


def test_names_that_are_no_identifiers_are_refused() -> None:
    for name in ("pkg/msg/A'); import os #", "A", "../../etc/passwd", "pkg/msg/A\n"):
        with pytest.raises(BadDefinition):
            fields_of("int8 x\n", name)
    with pytest.raises(BadDefinition, match="no field name"):
        needed_types({"pkg/msg/A": ([], [("x\nimport os", (1, ("int8", 0)))])}, "pkg/msg/A", lambda _: {})


def test_a_payload_of_more_values_than_memory_should_hold_is_not_read() -> None:
    channel = Channel("/tf", "tf2_msgs/msg/TFMessage", "ros1", "ros1msg", parts("pkg/A0[] a\n", "bool x\n").encode())
    decode = decoder_for(channel)
    assert decode is not None
    count = MOST_VALUES // 2 + 1
    with pytest.raises(DecodeError, match="may hold more than"):
        decode(count.to_bytes(4, "little") + bytes(count))
