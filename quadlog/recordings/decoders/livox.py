"""Livox CustomMsg (livox_ros_driver and livox_ros_driver2), straight from the payload."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import PointCloud
from quadlog.recordings.decoders.point_fields import Block, Column, MakeCloud, check_block, cloud_from_block
from quadlog.recordings.payload_reader import Payload, PayloadReader

POINT_BYTES = 19  # offset_time, x, y, z, reflectivity, tag, line
CDR_STRIDE = 20  # each point starts on a multiple of its first field's four bytes


def livox_decoder(
    topic: str, encoding: str, make_cloud: MakeCloud = cloud_from_block
) -> Callable[[Payload], PointCloud]:
    """A decoder of CustomMsg payloads; ``line`` becomes ring, ``offset_time`` offset_ns."""

    def decode(payload: Payload) -> PointCloud:
        return decode_livox(payload, encoding, topic, make_cloud)

    return decode


def decode_livox(payload: Payload, encoding: str, topic: str, make_cloud: MakeCloud = cloud_from_block) -> PointCloud:
    """One CustomMsg; the number of points is checked against the payload before anything is allocated."""
    reader = PayloadReader(payload, encoding, topic)
    header = reader.header()
    timebase_ns = reader.uint64()
    reader.uint32()  # point_num, which the sequence's own length repeats
    reader.skip(1 + 3)  # lidar_id, rsvd
    count = reader.uint32()
    stride = POINT_BYTES if reader.ros1 else CDR_STRIDE
    size = max(0, count * stride - (stride - POINT_BYTES))
    begin = reader.skip(size)
    if len(payload) - reader.at > 3:
        raise DecodeError(topic, f"{len(payload) - reader.at} bytes more than its {count} points need")
    # The closing padding of the last point is not sent, so the block's own step stops at its last byte.
    block = Block(payload, begin, count, 1, stride, POINT_BYTES)
    fields = {
        "offset_time": Column(0, np.dtype(reader.order + "u4")),
        "x": Column(4, np.dtype(reader.order + "f4")),
        "y": Column(8, np.dtype(reader.order + "f4")),
        "z": Column(12, np.dtype(reader.order + "f4")),
        "line": Column(18, np.dtype("u1")),
    }
    check_block(topic, block, size, fields)
    # Offsets count from timebase, which some drivers set apart from the header's stamp.
    cloud = make_cloud(topic, block, fields, header.stamp_ns, header.frame_id)
    return _relative_to_stamp(cloud, timebase_ns)


def _relative_to_stamp(cloud: PointCloud, timebase_ns: int) -> PointCloud:
    times = cloud.times
    if times is None or cloud.stamp_ns is None:
        return cloud
    shift_ns = timebase_ns - cloud.stamp_ns
    if shift_ns == 0 or abs(shift_ns) > 1_000_000_000:
        return cloud
    first_ns, last_ns = times.first_ns + shift_ns, times.last_ns + shift_ns
    return replace(cloud, times=replace(times, first_ns=first_ns, last_ns=last_ns, shift_ns=-shift_ns))
