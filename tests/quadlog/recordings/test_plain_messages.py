"""What is read by one struct, against rosbags: the same values of sound payloads, and no more of unsound ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.errors import DecodeError
from quadlog.recordings.container import Channel
from quadlog.recordings.decoding import LINKTRACK, PLAIN, PLAIN_LINKTRACK, ROS, decoder_for
from quadlog.recordings.plain_messages import KEPT_BYTES, KEPT_LAYOUTS, PlainReader
from quadlog.recordings.ros_messages import BUNDLED, Definitions

TAGFRAME = "nlink_parser/msg/LinktrackTagframe0"
STAMPED_TAGFRAME = "ros2_port/msg/LinktrackTagframe0"
KINDS = ["ros1", "little", "big"]


def store_of(kind: str) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    text = (BUNDLED / "nlink_parser" / "msg" / "LinktrackTagframe0.msg").read_text()
    store.register(get_types_from_msg(text, TAGFRAME))
    store.register(get_types_from_msg("std_msgs/Header header\n" + text, STAMPED_TAGFRAME))
    if kind == "ros1":
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf/msg/tfMessage"))
    return store


STORES = {kind: store_of(kind) for kind in KINDS}
PLAIN_TYPES = [*PLAIN, TAGFRAME, STAMPED_TAGFRAME]
CASES = [(kind, name) for kind in KINDS for name in PLAIN_TYPES if name in STORES[kind].fielddefs]

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


def oracle_for(channel: Channel) -> Callable[[bytes], Any]:
    """The way through rosbags' objects."""
    if channel.type_name in ROS:
        decode = Definitions().decoder(channel, ROS[channel.type_name])
        return lambda payload: (decode(payload),)
    return Definitions().decoder(channel, LINKTRACK[channel.type_name.rpartition("/")[2]])


def by_hand(channel: Channel) -> Callable[[bytes], Any]:
    decode = decoder_for(channel)
    assert decode is not None
    return decode


def outcome(decode: Callable[[bytes], Any], payload: bytes) -> Any:
    try:
        return decode(payload)
    except DecodeError:
        return DecodeError


def assert_same(one: Any, other: Any) -> None:
    """Equal in every field, type and dtype, NaN like NaN."""
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for each, like in zip(one, other, strict=True):
            assert_same(each, like)
    elif is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    else:
        assert one == other


READERS = {case: (by_hand(channel_of(*case)), oracle_for(channel_of(*case))) for case in CASES}


def test_every_plain_type_is_read_by_hand_in_every_encoding() -> None:
    assert {name for _, name in CASES} == {*PLAIN, TAGFRAME, STAMPED_TAGFRAME}
    assert set(PLAIN) < set(ROS)
    assert set(PLAIN_LINKTRACK) < set(LINKTRACK)
    for kind, name in CASES:
        channel = channel_of(kind, name)
        plain = PLAIN.get(name) or PLAIN_LINKTRACK[name.rpartition("/")[2]]
        reader = Definitions().decoder(channel, lambda message, _: pytest.fail("not by hand"), plain)
        assert isinstance(reader.ways[0][0], PlainReader)  # type: ignore[attr-defined]


@settings(max_examples=20, deadline=None)
@given(st.data())
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_random_messages_fare_as_with_rosbags(kind: str, name: str, data: st.DataObject) -> None:
    """Sound, padded, with bytes flipped and cut. The reader lives on from one to the next, as it does in a topic."""
    hand, oracle = READERS[kind, name]
    sound = serialised(kind, message_of(data.draw, STORES[kind], name))
    padded = sound + bytes(data.draw(st.integers(0, 5)))
    flipped = bytearray(sound)
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(0, min(len(sound), 64) - 1))
        flipped[at] = data.draw(st.sampled_from([0, 1, 5, 0x7F, 0x80, 0xFF]) | st.integers(0, 255))
    cut = bytes(flipped[: data.draw(st.integers(0, len(flipped)))])
    for payload in (sound, padded, bytes(flipped), cut, sound):
        assert_same(outcome(hand, memoryview(payload)), outcome(oracle, payload))


VERSIONS = [
    b"std_msgs/Header header\nuint8[3] more\nfloat32 x\nfloat32 y\nfloat64 z\n",
    b"string note\nstd_msgs/Header header\nfloat64 z\nfloat64 y\nfloat64 x\n",
    b"float64 x\nfloat64 y\nfloat64 z\n",
    b"std_msgs/Header header\nint64 x\nint16 y\nuint8 z\nstring[] notes\n",
]


@settings(max_examples=20, deadline=None)
@given(st.data())
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("text", VERSIONS)
def test_other_definitions_of_a_standard_type_are_kept_to(kind: str, text: bytes, data: st.DataObject) -> None:
    """A Point of other fields or another order inside a PoseStamped: read by its own definition, or refused."""
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
    assert_same(outcome(by_hand(channel), payload), outcome(oracle_for(channel), payload))


def test_a_stamp_that_is_not_where_it_usually_is_is_not_left_out() -> None:
    """A frame whose header comes last must not pass for one without."""
    store = STORES["little"]
    text = (BUNDLED / "nlink_parser" / "msg" / "LinktrackTagframe0.msg").read_text() + "\nstd_msgs/Header header\n"
    definition = text + "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    channel = Channel("/uwb", TAGFRAME, "cdr", "ros2msg", definition.encode())
    own = get_typestore(Stores.ROS2_HUMBLE)
    own.register(get_types_from_msg(text, TAGFRAME))
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](3, 4), "uwb")
    body = [np.zeros(n, np.float32) for n in (3, 3, 3, 8, 3, 4, 3, 3)]
    payload = bytes(own.serialize_cdr(own.types[TAGFRAME](2, 7, 0, 0, 4.0, *body, header), TAGFRAME))
    (ranges,) = by_hand(channel)(payload)
    assert (ranges.tag, ranges.stamp_ns) == (7, 3_000_000_004)


def test_a_definition_without_the_usual_fields_is_refused() -> None:
    channel = Channel("/imu", "sensor_msgs/msg/Imu", "ros1", "ros1msg", b"uint32 other\n")
    with pytest.raises(DecodeError, match="not the usual"):
        by_hand(channel)(bytes(4))


def test_layouts_are_kept_within_bounds() -> None:
    """Thousands of lengths, and one payload of a megabyte, leave no more than a few small layouts behind."""
    channel = channel_of("little", "geometry_msgs/msg/PoseStamped")
    decode = Definitions().decoder(channel, lambda message, _: message, PLAIN[channel.type_name])
    reader = decode.ways[0][0]  # type: ignore[attr-defined]
    pose = STORES["little"].types["geometry_msgs/msg/PoseStamped"]
    inner = message_of(lambda _: 0.5, STORES["little"], "geometry_msgs/msg/Pose")
    for length in (*range(500), 1 << 20):
        header = message_of(lambda _: 1, STORES["little"], "builtin_interfaces/msg/Time")
        header = STORES["little"].types["std_msgs/msg/Header"](header, "m" * length)
        assert decode(serialised("little", pose(header, inner)))
        assert len(reader._known) <= KEPT_LAYOUTS
        assert max(reader._known) <= KEPT_BYTES
