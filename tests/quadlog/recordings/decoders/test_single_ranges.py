"""Messages that carry one range: Range, UwbRange and Ranging."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ros_messages import BUNDLED
from quadlog.recordings.decoding import decoder_for

T_NS = 1_700_000_000_000_000_005


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize("range_m", [3.25, -math.inf, math.nan, 0.0, -1.0, math.inf])
def test_a_range_with_zero_limits_is_kept(ros: Any, embedded: bool, range_m: float) -> None:
    """What is no distance is passed on to be counted; infinity alone says that nothing was measured."""
    message = ros.type("sensor_msgs/msg/Range")(ros.header(T_NS, ""), 0, 0.0, 0.0, 0.0, range_m)
    channel = ros.channel("/uwb/n_3", "sensor_msgs/msg/Range")
    if not embedded:
        channel = Channel(channel.topic, channel.type_name, channel.message_encoding, "", b"")
    (ranges,) = decoder_for(channel)(ros.serialise(message))  # type: ignore[misc]
    measured = range_m != math.inf
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist()) == (T_NS, None, [-1] * measured)
    np.testing.assert_array_equal(ranges.range_m, [range_m] * measured)


def test_newer_ranges_have_a_variance_and_are_told_apart_without_definition() -> None:
    store = get_typestore(Stores.LATEST)
    stamp = store.types["builtin_interfaces/msg/Time"](1, 2)
    header = store.types["std_msgs/msg/Header"](stamp, "")
    message: Any = store.types["sensor_msgs/msg/Range"](header, 0, 0.0, 0.0, 0.0, 3.25, 0.5)
    decoder = decoder_for(Channel("/r", "sensor_msgs/msg/Range", "cdr", "", b""))
    assert decoder is not None
    (ranges,) = decoder(bytes(store.serialize_cdr(message, "sensor_msgs/msg/Range")))
    assert ranges.range_m.tolist() == [3.25]  # type: ignore[union-attr]


def bundled(ros: Any, name: str) -> Any:
    if name not in ros.store.types:
        package, _, last = name.split("/")
        ros.store.register(get_types_from_msg((BUNDLED / package / "msg" / f"{last}.msg").read_text(), name))
    return ros.type(name)


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize(("millimetres", "range_m"), [(3456, 3.456), (0, 0.0), (-7, -0.007)])
def test_gtec_millimetres_become_metres(ros: Any, embedded: bool, millimetres: int, range_m: float) -> None:
    """Failures, 0 or less, are passed on to be counted."""
    message = bundled(ros, "gtec_msgs/msg/Ranging")(11, 2, millimetres, 7, -80.0, 0.01)
    channel = ros.channel("/gtec", "gtec_msgs/msg/Ranging")
    if not embedded:
        channel = Channel(channel.topic, channel.type_name, channel.message_encoding, "", b"")
    (ranges,) = decoder_for(channel)(ros.serialise(message))  # type: ignore[misc]
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist(), ranges.range_m.tolist()) == (None, 2, [11], [range_m])


@pytest.mark.parametrize("range_m", [7.5, 0.0, -2.0, math.nan, math.inf])
def test_uwb_driver_requester_is_the_tag(ros: Any, range_m: float) -> None:
    kind = bundled(ros, "uwb_driver/msg/UwbRange")
    point = ros.type("geometry_msgs/msg/Point")(0.0, 0.0, 0.0)
    numbers = (1, 200, 100, 0, 1, 0, 0, 5, range_m, 1.0, 1.0, 0.1, 0.1, 0.1, 0.0, 0.0, 1, 0, 0, 0, 0, 0, 0)
    message = kind(ros.header(T_NS), *numbers, point, point, point, point)
    channel = Channel("/uwb", "uwb_driver/msg/UwbRange", ros.encoding, "", b"")
    (ranges,) = decoder_for(channel)(ros.serialise(message))  # type: ignore[misc]
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist()) == (T_NS, 200, [100])
    np.testing.assert_array_equal(ranges.range_m, [range_m])
