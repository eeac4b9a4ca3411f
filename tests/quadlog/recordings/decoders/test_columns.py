"""Messages decoded by columns, against rosbags: the same values of sound payloads, and none of unsound ones."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.errors import DecodeError
from quadlog.messages import Imu, Odometry, Transforms, UwbRanges
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.columns import ColumnDecoder, Columns
from quadlog.recordings.decoders.ros_messages import BUNDLED, Definitions
from quadlog.recordings.decoding import (
    IN_COLUMNS,
    decoder_for,
    ways_in_columns,
)

TAGFRAME = "nlink_parser/msg/LinktrackTagframe0"
STAMPED_TAGFRAME = "ros2_port/msg/LinktrackTagframe0"
KINDS = ["ros1", "little", "big"]


def store_of(kind: str) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    text = (BUNDLED / "nlink_parser" / "msg" / "LinktrackTagframe0.msg").read_text()
    store.register(get_types_from_msg(text, TAGFRAME))
    store.register(get_types_from_msg("std_msgs/Header header\n" + text, STAMPED_TAGFRAME))
    return store


STORES = {kind: store_of(kind) for kind in KINDS}
COLUMN_TYPES = [*IN_COLUMNS, TAGFRAME, STAMPED_TAGFRAME]
CASES = [(kind, name) for kind in KINDS for name in COLUMN_TYPES if name in STORES[kind].fielddefs]

numbers = st.floats() | st.floats(-1e3, 1e3) | st.sampled_from([0.0, -1.0, 0.5])
names = st.text(st.characters(codec="utf-8"), max_size=9) | st.sampled_from(["map", "/odom", "base_link", ""])
ranges_of = {"int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1), "uint8": (0, 255)} | {
    "int16": (-(2**15), 2**15 - 1),
    "int64": (-(2**40), 2**40),
}


def value_of(draw: Callable[..., Any], store: Any, kind: Any, detail: Any) -> Any:
    """A random value of a field, by the definition rosbags has of it."""
    if kind.name == "NAME":
        return message_of(draw, store, detail)
    if kind.name == "SEQUENCE":
        return [value_of(draw, store, *detail[0]) for _ in range(draw(st.integers(0, 3)))]
    if kind.name == "ARRAY":
        (_, (base, _)), length = detail
        element = numbers if base == "float64" else st.floats(width=32) if base == "float32" else st.integers(0, 255)
        return np.resize(np.array(draw(st.lists(element, min_size=1, max_size=4)), base), length)
    if detail[0] == "string":
        return draw(names)
    if detail[0] == "float32":
        return draw(st.floats(width=32))
    return draw(numbers if detail[0] == "float64" else st.integers(*ranges_of[detail[0]]))


def message_of(draw: Callable[..., Any], store: Any, name: str) -> Any:
    values = [value_of(draw, store, *descriptor) for _, descriptor in store.fielddefs[name][1]]
    return store.types[name](*values)


def serialised(kind: str, message: Any) -> bytes:
    store, name = STORES[kind], message.__msgtype__
    if kind == "ros1":
        return bytes(store.serialize_ros1(message, name))
    return bytes(store.serialize_cdr(message, name, little_endian=kind == "little"))


def channel_of(kind: str, name: str) -> Channel:
    encoding, version = ("ros1", 1) if kind == "ros1" else ("cdr", 2)
    text, _ = STORES[kind].generate_msgdef(name, ros_version=version)
    return Channel("/topic", name, encoding, f"ros{version}msg", text.encode())


def column_decoder_of(channel: Channel, payload: bytes) -> ColumnDecoder | None:
    return Definitions().column_decoder(channel, payload, ways_in_columns(channel))


def oracle_for(channel: Channel) -> Callable[[bytes], Any]:
    """The way through rosbags' objects, message by message."""
    decode = decoder_for(channel)
    assert decode is not None
    return decode


def outcome(decode: Callable[[bytes], Any], payload: bytes) -> Any:
    try:
        return decode(payload)
    except DecodeError:
        return None


def in_columns(decoder: ColumnDecoder, payloads: list[bytes]) -> list[list[Any] | None]:
    """For each payload its row of every columns it is in, None where it is left out."""
    found: list[list[Any] | None] = [None] * len(payloads)
    for rows, columns in decoder.decode(payloads):
        for place, row in enumerate(rows.tolist()):
            assert found[row] is None
            found[row] = [
                each._replace(
                    stamp_ns=None if each.stamp_ns is None else each.stamp_ns[place], values=each.values[place]
                )
                for each in columns
            ]
    return found


def as_row(message: Any) -> list[Columns]:
    """A message as the row of columns that holds it, one for each transform."""
    if isinstance(message, Transforms):
        return [row for each in message.transforms for row in as_row(each)]
    if isinstance(message, UwbRanges):
        distances = np.zeros(8)
        distances[message.anchor] = message.range_m
        return [Columns(UwbRanges, message.stamp_ns, np.array([message.tag, *distances]))]
    if isinstance(message, Imu):
        quat_xyzw = np.full(4, np.nan) if message.quat_xyzw is None else message.quat_xyzw
        return [Columns(Imu, message.stamp_ns, np.concatenate([message.angular_radps, quat_xyzw]), message.frame_id)]
    values = [message.position_m, message.quat_xyzw]
    values += [message.linear_mps, message.angular_radps] if isinstance(message, Odometry) else []
    frames = message.frame_id, message.child_frame_id
    return [Columns(type(message), message.stamp_ns, np.concatenate(values), *frames)]


def assert_fares_as(oracle: Any, row: list[Columns] | None) -> None:
    """The same values where there are columns; without, rosbags must not have a say either, or be asked again."""
    if row is None:
        return
    assert oracle is not None
    (message,) = oracle
    expected = as_row(message)
    assert len(row) == len(expected)
    for got, want in zip(row, expected, strict=True):
        assert got._replace(values=0) == want._replace(values=0)
        np.testing.assert_array_equal(got.values, want.values)


@given(st.data())
@pytest.mark.parametrize("name", sorted({name for _, name in CASES}))
def test_random_messages_decode_as_with_rosbags(name: str, data: st.DataObject) -> None:
    """Sound, padded, with bytes flipped and cut, all in one batch."""
    kind = data.draw(st.sampled_from([kind for kind, other in CASES if other == name]))
    channel = channel_of(kind, name)
    sound = serialised(kind, message_of(data.draw, STORES[kind], name))
    decoder = column_decoder_of(channel, sound)
    assert decoder is not None
    other = serialised(kind, message_of(data.draw, STORES[kind], name))
    flipped = bytearray(other)
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(0, min(len(other), 64) - 1))
        flipped[at] = data.draw(st.sampled_from([0, 1, 5, 0x7F, 0x80, 0xFF]) | st.integers(0, 255))
    cut = bytes(flipped[: data.draw(st.integers(0, len(flipped)))])
    payloads = [sound, other, other + bytes(data.draw(st.integers(0, 5))), bytes(flipped), cut, sound]
    oracle = oracle_for(channel)
    rows = in_columns(decoder, payloads)
    for payload, row in zip(payloads, rows, strict=True):
        assert_fares_as(outcome(oracle, payload), row)
    if (expected := outcome(oracle, sound)) is not None:
        assert rows[0] is not None, expected


VERSIONS = [
    b"std_msgs/Header header\nuint8[3] more\nfloat32 x\nfloat32 y\nfloat64 z\n",
    b"string note\nstd_msgs/Header header\nfloat64 z\nfloat64 y\nfloat64 x\n",
    b"float64 x\nfloat64 y\nfloat64 z\n",
    b"std_msgs/Header header\nint64 x\nint16 y\nuint8 z\nstring[] notes\n",
]


@given(st.data())
@pytest.mark.parametrize("text", VERSIONS)
def test_other_definitions_of_a_standard_type_are_kept_to(text: bytes, data: st.DataObject) -> None:
    """A Point of other fields or another order inside a PoseStamped: read by its own definition, or refused."""
    kind = data.draw(st.sampled_from(KINDS))
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    own = get_typestore(Stores.EMPTY)
    own.register({name: store.fielddefs[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")})
    own.register(get_types_from_msg(text.decode(), "geometry_msgs/msg/Point"))
    own.register({"geometry_msgs/msg/Quaternion": store.fielddefs["geometry_msgs/msg/Quaternion"]})
    pose = "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    own.register(get_types_from_msg("Point position\nQuaternion orientation\n", "geometry_msgs/msg/Pose"))
    own.register(get_types_from_msg(pose, "geometry_msgs/msg/PoseStamped"))
    definition, _ = own.generate_msgdef("geometry_msgs/msg/PoseStamped", ros_version=1 if kind == "ros1" else 2)
    encoding = "ros1" if kind == "ros1" else "cdr"
    channel = Channel("/p", "geometry_msgs/msg/PoseStamped", encoding, "ros2msg", definition.encode())
    drawn = message_of(data.draw, SimpleNamespace(fielddefs=own.fielddefs, types=own.types), channel.type_name)
    payload = bytes(
        own.serialize_ros1(drawn, channel.type_name)
        if kind == "ros1"
        else own.serialize_cdr(drawn, channel.type_name, little_endian=kind == "little")
    )
    decoder = column_decoder_of(channel, payload)
    if decoder is not None:
        (row,) = in_columns(decoder, [payload])
        assert_fares_as(outcome(oracle_for(channel), payload), row)
