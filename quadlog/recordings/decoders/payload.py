"""A payload read field by field, for clouds."""

from __future__ import annotations

import struct
from typing import NamedTuple

from quadlog.errors import DecodeError
from quadlog.messages import NS_PER_S


def nanoseconds(seconds: int, nanos: int) -> int:
    """A stamp's two numbers as one."""
    return seconds * NS_PER_S + nanos


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of old ROS 1."""
    return str(name).removeprefix("/")


Payload = bytes | memoryview

LARGEST_NAME = 4096


class Header(NamedTuple):
    """A std_msgs/Header: time in nanoseconds and the frame's name."""

    stamp_ns: int
    frame_id: str


class PayloadReader:
    """A cursor over one payload. encoding is ``ros1`` or ``cdr``; raises DecodeError past the end."""

    def __init__(self, payload: Payload, encoding: str, topic: str) -> None:
        self.payload, self.topic = payload, topic
        self.ros1 = encoding == "ros1"
        self.order, self.start = "<", 0
        if not self.ros1:
            kind = bytes(payload[:2])
            if len(payload) < 4 or kind not in (b"\x00\x00", b"\x00\x01"):
                raise DecodeError(topic, f"not a plain CDR payload (starts with {kind.hex() or 'nothing'})")
            self.order, self.start = ("<" if kind[1] else ">"), 4
        self.at = self.start

    def number(self, code: str, size: int) -> int:
        """The next integer of a struct format code and its size in bytes."""
        if not self.ros1:
            self.at = self.start + (self.at - self.start + size - 1) // size * size
        try:
            (value,) = struct.unpack_from(self.order + code, self.payload, self.at)
        except struct.error:
            raise DecodeError(self.topic, f"ends after {len(self.payload)} bytes, in the middle of a field") from None
        self.at += size
        return int(value)

    def uint8(self) -> int:
        return self.number("B", 1)

    def uint32(self) -> int:
        return self.number("I", 4)

    def uint64(self) -> int:
        return self.number("Q", 8)

    def skip(self, size: int) -> int:
        """Where the next size bytes begin, having checked that they are there."""
        begin = self.at
        if size > len(self.payload) - begin:
            raise DecodeError(self.topic, f"holds {len(self.payload) - begin} of the {size} bytes it announces")
        self.at = begin + size
        return begin

    def name(self) -> str:
        """A short string; CDR counts its closing zero byte, ROS 1 has none."""
        size = self.uint32()
        if size > LARGEST_NAME:
            raise DecodeError(self.topic, f"a name of {size} bytes")
        begin = self.skip(size)
        return bytes(self.payload[begin : begin + size]).rstrip(b"\0").decode("utf-8", "replace")

    def header(self) -> Header:
        """The std_msgs/Header at the cursor (ROS 1 has a sequence number before the stamp)."""
        if self.ros1:
            self.uint32()
        seconds = self.number("I" if self.ros1 else "i", 4)
        return Header(nanoseconds(seconds, self.uint32()), frame_name(self.name()))
