"""The stamp at the front of a payload, without decoding the rest: for every type that starts with a std_msgs/Header."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

from quadlog.errors import DecodeError
from quadlog.recordings.container import Channel
from quadlog.recordings.payload_reader import Payload, PayloadReader
from quadlog.recordings.ros_messages import standard_types

HEADER_TYPE = "std_msgs/msg/Header"
HEADER_LINE = re.compile(r"(std_msgs/(msg/)?)?Header\s+\w+\s*(#.*)?")
IDL_STRUCT = re.compile(r"struct\s+(\w+)\s*\{([^}]*)\}")
FRONT_BYTES = 1 << 16  # of a definition; its first field stands near the top


def stamp_reader(channel: Channel) -> Callable[[Payload], int | None] | None:
    """A function from payload to header.stamp in nanoseconds (None for a broken payload); None without header."""
    if channel.message_encoding not in ("ros1", "cdr") or not starts_with_header(channel):
        return None

    def read(payload: Payload) -> int | None:
        try:
            return PayloadReader(payload, channel.message_encoding, channel.topic).header().stamp_ns
        except DecodeError:
            return None

    return read


def starts_with_header(channel: Channel) -> bool:
    """Whether the message's first field is a std_msgs/Header, by the embedded definition or the standard one."""
    return _starts_with_header(
        channel.type_name, channel.message_encoding, channel.schema_encoding, channel.schema[:FRONT_BYTES]
    )


@lru_cache(maxsize=64)
def _starts_with_header(type_name: str, message_encoding: str, schema_encoding: str, front: bytes) -> bool:
    text = front.decode("utf-8", "replace")
    if not text.strip("\0 \n"):
        fields = standard_types(message_encoding, type_name).get(type_name, ([], []))[1]
        return bool(fields) and fields[0][1][1] == HEADER_TYPE
    if schema_encoding == "ros2idl":
        name = type_name.rpartition("/")[2]
        bodies = [body for struct, body in IDL_STRUCT.findall(text) if struct == name]
        return bool(bodies) and re.sub(r"@\w+\s*(\([^()]*\))?", "", bodies[0]).strip().startswith(
            "std_msgs::msg::Header"
        )
    for line in text.splitlines():
        bare = line.split("#")[0].strip()
        if bare and "=" not in bare:
            return HEADER_LINE.fullmatch(bare) is not None
    return False
