"""Messages of numbers and strings, read by one `struct` that covers the whole payload.

A topic's messages are laid out alike; only the lengths of strings and lists
could differ. So a payload is walked field by field, and what that teaches
serves all later ones of that size which hold the same lengths and strings.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any, NamedTuple

from quadlog.recordings.payload_reader import Payload
from quadlog.recordings.plain_fields import LIST, STRING, PlainField

KEPT_LAYOUTS = 16
KEPT_BYTES = 1 << 14
CDR_MARKS = {b"\0\0": ">", b"\0\1": "<"}
CDR_SLACK = 3  # bytes by which writers may fill a payload up

# The wanted strings and the wanted numbers of a message, each in the definition's order.
Values = tuple[tuple[str, ...], tuple[Any, ...]]
Pick = Callable[[tuple[Any, ...]], tuple[Any, ...]]


class Misfit(ValueError):
    """A payload that is none of its type; says why."""


class Layout(NamedTuple):
    """How payloads of one size are cut, which of the values must be those of the first, and which are wanted."""

    cut: struct.Struct
    lengths_and_strings: Pick
    first: tuple[Any, ...]
    texts: tuple[str, ...]
    numbers: Pick


class PlainReader:
    """Reads payloads of one type, encoded as ``ros1`` or ``cdr``; raises Misfit for all that rosbags would refuse."""

    def __init__(self, fields: tuple[PlainField, ...], encoding: str) -> None:
        self._fields, self._cdr = fields, encoding != "ros1"
        self._known: dict[int, Layout] = {}

    def __call__(self, payload: Payload) -> Values:
        """The wanted values of a message."""
        layout = self._known.get(len(payload)) or self._learn(payload)
        values = layout.cut.unpack_from(payload)
        if layout.lengths_and_strings(values) != layout.first:
            layout = self._learn(payload)
            values = layout.cut.unpack_from(payload)
        return layout.texts, layout.numbers(values)

    def _learn(self, payload: Payload) -> Layout:
        walk = _Walk(payload, self._cdr)
        walk.along(self._fields)
        left = len(payload) - walk.at
        if left > (CDR_SLACK if self._cdr else 0):
            raise Misfit(f"{left} bytes are left over")
        layout = walk.layout()
        if len(self._known) == KEPT_LAYOUTS:
            self._known.clear()
        if len(payload) <= KEPT_BYTES:
            self._known[len(payload)] = layout
        return layout


@dataclass
class _Walk:
    """A `struct` format that grows along one payload, and the places of values in it."""

    payload: Payload
    cdr: bool
    at: int = 0
    order: str = "<"
    format: list[str] = field(default_factory=list)
    values: int = 0
    fixed: list[int] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.cdr:
            mark = bytes(self.payload[:2])
            if mark not in CDR_MARKS:
                raise Misfit(f"not a plain CDR payload (starts with {mark.hex() or 'nothing'})")
            self.order = CDR_MARKS[mark]
            self._fix("2s2x", 4)

    def along(self, fields: tuple[PlainField, ...]) -> None:
        """Over the fields; raises Misfit where the payload ends before them."""
        for each in fields:
            if each.code == STRING:
                self._string(wanted=each.wanted is not None)
            elif each.code == LIST:
                for _ in range(self._length()):
                    self.along(each.elements)
            else:
                self._number(each.code, each.repeated, each.wanted or 0)

    def layout(self) -> Layout:
        """What was learnt."""
        cut = struct.Struct(self.order + "".join(self.format))
        pick = _pick(self.fixed)
        return Layout(cut, pick, pick(cut.unpack_from(self.payload)), tuple(self.texts), _pick(self.numbers))

    def _number(self, code: str, count: int, wanted: int) -> None:
        size = struct.calcsize(f"={code}")
        self._align(size)
        self.numbers += range(self.values, self.values + wanted)
        self._take(f"{wanted}{code}{(count - wanted) * size}x", count * size, wanted)

    def _string(self, *, wanted: bool) -> None:
        length = self._length()
        end = self._fix(f"{length}s", length)
        raw = bytes(self.payload[end - length : end])
        if self.cdr and raw[-1:] != b"\0":
            raise Misfit("a string does not end with its zero byte")
        try:
            text = (raw[:-1] if self.cdr else raw).decode()
        except UnicodeDecodeError:
            raise Misfit("a string is not UTF-8") from None
        self.texts += [text] if wanted else []

    def _length(self) -> int:
        self._align(4)
        end = self._fix("I", 4)
        (length,) = struct.unpack_from(f"{self.order}I", self.payload, end - 4)
        return int(length)

    def _align(self, size: int) -> None:
        # CDR counts from behind its four first bytes, which are a multiple of four alone.
        if self.cdr and (padding := (4 - self.at) % size):
            self._take(f"{padding}x", padding, 0)

    def _fix(self, code: str, size: int) -> int:
        self.fixed.append(self.values)
        return self._take(code, size, 1)

    def _take(self, code: str, size: int, values: int) -> int:
        self.at += size
        if self.at > len(self.payload):
            raise Misfit(f"it ends after {len(self.payload)} bytes, in the middle of a field")
        self.format.append(code)
        self.values += values
        return self.at


def _pick(places: list[int]) -> Pick:
    if len(places) > 1:
        return itemgetter(*places)
    return lambda values: tuple(values[place] for place in places)
