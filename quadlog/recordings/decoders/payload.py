"""A payload read field by field."""

from __future__ import annotations

from typing import NamedTuple

from quadlog.errors import DecodeError
from quadlog.messages import NS_PER_S

Payload = bytes | memoryview
CDR_ORDER, CDR_SLACK = {b"\0\0": ">", b"\0\1": "<"}, 3  # writers may fill a payload up to four bytes


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of old ROS 1."""
    return str(name).removeprefix("/")


class Header(NamedTuple):
    """A std_msgs/Header: time in nanoseconds, None in other messages without one, and the frame's name."""

    stamp_ns: int | None
    frame_id: str


class PayloadReader:
    """A cursor over one payload, encoded as ``ros1`` or ``cdr``. All raises DecodeError, as where the payload ends."""

    def __init__(self, payload: Payload, encoding: str, topic: str) -> None:
        self.payload, self.topic, self.ros1, self.order, self.at = payload, topic, encoding == "ros1", "<", 0
        if not self.ros1:
            mark = bytes(payload[:2])
            if mark not in CDR_ORDER:
                raise self.wrong(f"not a plain CDR payload (starts with {mark.hex() or 'nothing'})")
            self.order = CDR_ORDER[mark]
            self.skip(4)

    def wrong(self, why: str) -> DecodeError:
        return DecodeError(self.topic, why)

    def skip(self, size: int) -> int:
        """Where the next size bytes begin, having checked that they are there."""
        begin, self.at = self.at, self.at + size
        if self.at > len(self.payload):
            raise self.wrong(f"it ends after {len(self.payload)} bytes, in the middle of a field")
        return begin

    def numbers(self, dtype: str, count: int = 1) -> int:
        """Where numbers of a dtype, as "u4", begin; the cursor is behind them."""
        size = int(dtype[1])
        if not self.ros1 and count:  # counts from behind its first four bytes; an empty sequence is not aligned
            self.skip((4 - self.at) % size)
        return self.skip(count * size)

    def whole(self, dtype: str) -> int:
        """The next whole number without sign."""
        begin = self.numbers(dtype)
        return int.from_bytes(self.payload[begin : self.at], "little" if self.order == "<" else "big")

    def text(self, size: int | None = None, at: int | None = None) -> str:
        """The next string, or the one of a size at a place; CDR counts its closing zero byte, ROS 1 has none."""
        self.at = self.at if at is None else at
        begin = self.skip(self.whole("u4") if size is None else size)
        raw = bytes(self.payload[begin : self.at])
        if not self.ros1 and raw[-1:] != b"\0":
            raise self.wrong("a string does not end with its zero byte")
        try:
            return (raw if self.ros1 else raw[:-1]).decode()
        except UnicodeDecodeError:
            raise self.wrong("a string is not UTF-8") from None

    def header(self) -> Header:
        """The std_msgs/Header at the cursor (ROS 1 has a sequence number before the stamp)."""
        if self.ros1:
            self.skip(4)
        seconds = self.whole("u4")
        signed = seconds if self.ros1 or seconds < 1 << 31 else seconds - (1 << 32)
        return Header(signed * NS_PER_S + self.whole("u4"), frame_name(self.text()))

    def end(self) -> None:
        """Raise unless the payload ends here."""
        left = len(self.payload) - self.at
        if left > (0 if self.ros1 else CDR_SLACK):
            raise self.wrong(f"{left} bytes are left over")
