from __future__ import annotations

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.recordings.type_definitions import (
    LARGEST_DEFINITION_BYTES,
    BadDefinition,
    needed_types,
    parse_definition,
)


def fields_of(text: str, name: str = "pkg/msg/A", encoding: str = "ros2msg") -> list[str]:
    types = parse_definition(text.encode(), name, encoding)
    return [field for field, _ in needed_types(types, name, lambda _: {})[name][1]]


def test_a_definition_with_its_parts() -> None:
    text = "B b\nfloat32 x # metres\nstring NAME=import os\n" + "=" * 80 + "\nMSG: pkg/B\nint8 c\n"
    assert fields_of(text) == ["b", "x"]
    types = parse_definition(text, "pkg/msg/A", "ros2msg")
    assert all(constants == [] for constants, _ in needed_types(types, "pkg/msg/A", lambda _: {}).values())


def test_separators_of_any_length_and_windows_line_ends() -> None:
    assert fields_of("B b\r\n=====\r\nMSG: pkg/B\r\nint8 c\r\n") == ["b"]


def test_idl() -> None:
    text = """
    module pkg { module msg {
      @verbatim (language="comment", text="a (nested (thing)) << here")
      struct A { double x; sequence<float, 3> y; };
    }; };
    """
    assert fields_of(text, encoding="ros2idl") == ["x", "y"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("B b\n", "missing"),
        ("A a\nA b\n", "contains itself"),
        ("string[1000000000] s\n", "array of"),
        ("float32 x\n!!! ???\n", "parsed"),
        ("x" * (LARGEST_DEFINITION_BYTES + 1), "larger"),
    ],
)
def test_what_is_refused(text: str, why: str) -> None:
    with pytest.raises(BadDefinition, match=why):
        fields_of(text)


def test_names_that_are_no_identifiers_are_refused() -> None:
    for name in ("pkg/msg/A'); import os #", "A", "../../etc/passwd", "pkg/msg/A\n"):
        with pytest.raises(BadDefinition):
            fields_of("int8 x\n", name)
    with pytest.raises(BadDefinition, match="no field name"):
        needed_types({"pkg/msg/A": ([], [("x\nimport os", (1, ("int8", 0)))])}, "pkg/msg/A", lambda _: {})


def test_unknown_language_is_named() -> None:
    with pytest.raises(BadDefinition, match="flatbuffer"):
        fields_of("table A {}", encoding="flatbuffer")


@pytest.mark.parametrize("expression", ["1 << 99999999999", "((((((((((1))))))))))", "9" * 40])
def test_idl_arithmetic_that_never_ends_is_refused(expression: str) -> None:
    text = f"module pkg {{ module msg {{ const int64 X = {expression}; struct A {{ double x; }}; }}; }};"
    with pytest.raises(BadDefinition, match="computed constants"):
        fields_of(text, encoding="ros2idl")


@settings(max_examples=150, deadline=None)
@given(text=st.text(max_size=80), encoding=st.sampled_from(["ros1msg", "ros2msg", "ros2idl"]))
def test_any_text_parses_or_is_refused(text: str, encoding: str) -> None:
    with contextlib.suppress(BadDefinition):
        fields_of(text, encoding=encoding)
