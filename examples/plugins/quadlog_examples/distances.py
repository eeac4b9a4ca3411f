"""beacon_msgs/Distances, the message of a made-up UWB driver: a tag's distances in metres to its beacons.

Its fields: std_msgs/Header header, uint8 tag, uint16[] beacons, and float32[] distances, beside beacons and negative
where one did not answer.
"""

from __future__ import annotations

from typing import Any

from quadlog.messages import UwbRanges
from quadlog.recordings.plugged import MessageDecoder


def decode(message: Any, topic: str) -> list[UwbRanges]:
    """One tag's ranges to all beacons that answered; fields are as the message's definition names them."""
    stamp = message.header.stamp
    answered = message.distances >= 0
    return [
        UwbRanges(
            stamp_ns=stamp.sec * 1_000_000_000 + stamp.nanosec,
            tag=message.tag,
            anchor=message.beacons[answered],
            range_m=message.distances[answered],
        )
    ]


decoder = MessageDecoder(gives=UwbRanges, decode=decode)
