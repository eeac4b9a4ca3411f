from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from quadlog.errors import DecodeError
from quadlog.recordings.decoders.point_cloud import livox_decoder
from quadlog.recordings.decoders.ros_messages import BUNDLED

T_NS = 1_700_000_000_000_000_000


def custom_message(ros: Any, count: int, timebase_ns: int = T_NS, frame: str = "livox") -> Any:
    """A CustomMsg made and serialised by rosbags from the bundled definition."""
    if "livox_ros_driver/msg/CustomMsg" not in ros.store.types:
        types: dict = {}
        for name in ("CustomMsg", "CustomPoint"):
            text = (BUNDLED / "livox_ros_driver" / "msg" / f"{name}.msg").read_text()
            types.update(get_types_from_msg(text, f"livox_ros_driver/msg/{name}"))
        ros.store.register(types)
    point = ros.type("livox_ros_driver/msg/CustomPoint")
    points = [point(1000 * i, i + 0.25, -i, 2.0 * i, 7, 1, i % 4) for i in range(count)]
    return ros.type("livox_ros_driver/msg/CustomMsg")(
        ros.header(T_NS, frame), timebase_ns, count, 3, np.zeros(3, np.uint8), points
    )


@pytest.mark.parametrize("count", [0, 1, 2, 5])
@pytest.mark.parametrize("big_endian", [False, True])
def test_points_lines_and_offsets(ros: Any, count: int, big_endian: bool) -> None:
    payload = ros.serialise(custom_message(ros, count), big_endian=big_endian)
    cloud = livox_decoder("/livox/lidar", ros.encoding)(payload)
    i = np.arange(count)
    np.testing.assert_array_equal(cloud.xyz_m, np.column_stack([i + 0.25, -i, 2 * i]).astype(np.float32))
    assert cloud.stamp_ns == T_NS
    assert cloud.frame_id == "livox"
    if count:
        assert cloud.ring is not None
        assert cloud.offset_ns is not None
        np.testing.assert_array_equal(cloud.ring, i % 4)
        np.testing.assert_array_equal(cloud.offset_ns, 1000 * i)


def test_offsets_count_from_the_timebase(ros: Any) -> None:
    cloud = livox_decoder("/livox/lidar", ros.encoding)(ros.serialise(custom_message(ros, 3, T_NS + 500)))
    np.testing.assert_array_equal(cloud.offset_ns, [500, 1500, 2500])  # type: ignore[arg-type]


@pytest.mark.parametrize("frame", ["", "a", "abc", "livox_frame", "livox_frame_2"])
def test_frame_names_of_any_length(ros: Any, frame: str) -> None:
    """Their length decides where CDR aligns the eight bytes that follow."""
    cloud = livox_decoder("/livox/lidar", ros.encoding)(ros.serialise(custom_message(ros, 2, T_NS + 7, frame)))
    assert cloud.frame_id == frame
    assert cloud.offset_ns is not None
    assert cloud.offset_ns.tolist() == [7, 1007]


def test_cut_or_longer_payloads_are_refused(ros: Any) -> None:
    payload = ros.serialise(custom_message(ros, 4))
    for damaged in (payload[:-1], payload[:40], b"", payload + bytes(19)):
        with pytest.raises(DecodeError):
            livox_decoder("/livox/lidar", ros.encoding)(damaged)
