"""The stamp and frame of a deserialised ROS message, for those that have a header and those that have none."""

from __future__ import annotations

from typing import Any


def stamp_ns(message: Any) -> int | None:
    """header.stamp in nanoseconds, or None for a message without header."""
    header = getattr(message, "header", None)
    if header is None:
        return None
    return nanoseconds(int(header.stamp.sec), int(header.stamp.nanosec))


def nanoseconds(seconds: int, nanos: int) -> int:
    """A stamp's two numbers as one."""
    return seconds * 1_000_000_000 + nanos


def frame_id(message: Any) -> str:
    """header.frame_id, or an empty name; ROS 1 names may begin with a slash that ROS 2 forbids."""
    header = getattr(message, "header", None)
    return "" if header is None else frame_name(header.frame_id)


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of old ROS 1."""
    return str(name).removeprefix("/")
