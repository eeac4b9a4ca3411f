"""How instants, counts and type names are spelled, the same for every container."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

# Below this a clock counts from its own start (simulation time), not from 1970.
_FIRST_CALENDAR_NS = 10**17


def instant(t_ns: int) -> str:
    """`2024-05-01T10:00:00.250Z`, or `47.600 s` for clocks that start near zero."""
    if t_ns < _FIRST_CALENDAR_NS:
        return f"{t_ns / 1e9:.3f} s"
    whole = datetime.fromtimestamp(t_ns // 10**9, UTC)
    return f"{whole:%Y-%m-%dT%H:%M:%S}.{t_ns % 10**9 // 10**6:03d}Z"


def stamps_go_back(back_ns: int, t_ns: int) -> str:
    """That a topic's stamps go back by so much, to an instant."""
    return f"header stamps go back by {back_ns * 1e-9:.2f} s, to {instant(t_ns)}"


def several(count: int, thing: str) -> str:
    """`1 message`, `2 messages`."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def listed(items: Sequence[object], most: int = 10) -> str:
    """`1, 2, 3 and 4 more`."""
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(map(str, items[:most])) + more


def ros2_type_name(name: str) -> str:
    """`sensor_msgs/PointCloud2` and `sensor_msgs::msg::PointCloud2` as `sensor_msgs/msg/PointCloud2`.

    ROS 1 has one message under two names, `tf/tfMessage` and `tf2_msgs/TFMessage`, often both on /tf.
    """
    if name == "tf/tfMessage":
        return "tf2_msgs/msg/TFMessage"
    parts = name.replace("::", "/").split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)
