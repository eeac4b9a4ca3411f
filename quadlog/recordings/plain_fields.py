"""Definitions made of nothing but numbers, strings, fixed arrays and lists of such, laid out flat.

These are what `plain_messages` can read in one go. Which of their fields are
wanted is said by path, so a recording's own version of a message will do as
long as it has them, in the usual order.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype

from quadlog.recordings.type_definitions import Types

# Path of a field -> how many of its elements are wanted; TEXT for a string, WHOLE for one whole number,
# ABSENT where there must be no such field.
Wanted = Mapping[str, int]
TEXT, ABSENT, WHOLE = 0, -1, -2

STRING, LIST = "s", "["
CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "int16": "h",
    "int32": "i",
    "int64": "q",
    "uint8": "B",
    "uint16": "H",
    "uint32": "I",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


class PlainField(NamedTuple):
    """A `struct` code repeated, of which the first few are wanted (None: none); or a list of elements."""

    code: str
    repeated: int = 1
    wanted: int | None = None
    elements: tuple[PlainField, ...] = ()


def each_of(path: str, names: str) -> dict[str, int]:
    """`a.x` and `a.y` for the path `a` and the names `xy`: one number of each."""
    return {f"{path}.{name}": 1 for name in names}


def header_of(path: str) -> dict[str, int]:
    """Both numbers of the stamp and the frame's name of a std_msgs/Header."""
    return {f"{path}.stamp.sec": WHOLE, f"{path}.stamp.nanosec": WHOLE, f"{path}.frame_id": TEXT}


def plain_fields(types: Types, type_name: str, wanted: Wanted) -> tuple[PlainField, ...] | None:
    """A type's fields without the types between; None where other kinds are among them, or not those that are wanted.

    types: a checked table (`needed_types`), in which no type contains itself.
    """
    found: list[tuple[str, int]] = []
    fields = _flat(types, type_name, "", wanted, found)
    return fields if found == [each for each in wanted.items() if each[1] != ABSENT] else None


def _flat(
    types: Types, name: str, prefix: str, wanted: Wanted, found: list[tuple[str, int]]
) -> tuple[PlainField, ...] | None:
    """The fields from here down; found gets the wanted ones in the order in which they come."""
    flat: list[PlainField] = []
    for field_name, (kind, detail) in types[name][1]:
        path = prefix + field_name
        inner: tuple[PlainField, ...] | None
        if kind == Nodetype.NAME:
            inner = _flat(types, detail, f"{path}.", wanted, found)
        elif kind == Nodetype.SEQUENCE and detail[0][0] == Nodetype.NAME:
            elements = _flat(types, detail[0][1], f"{path}.", wanted, found)
            inner = elements and (PlainField(LIST, elements=elements),)
        else:
            inner = _basic(kind, detail, wanted.get(path))
            found += [(path, wanted[path])] if path in wanted else []
        if not inner:
            return None
        flat += inner
    return tuple(flat)


def _basic(kind: Nodetype, detail: Any, wanted: int | None) -> tuple[PlainField] | None:
    if kind == Nodetype.BASE and detail[0] == "string" and wanted in (None, TEXT):
        return (PlainField(STRING, wanted=wanted),)
    (_, detail), count = detail if kind == Nodetype.ARRAY else ((kind, detail), 1)
    code = CODES.get(detail[0]) if kind in (Nodetype.BASE, Nodetype.ARRAY) else None
    if code is None or wanted == TEXT or count < max(wanted or 0, 1) or (wanted == WHOLE and code in "?fd"):
        return None
    return (PlainField(code, count, 1 if wanted == WHOLE else wanted),)
