"""Fields of messages as columns, against rosbags' objects: the same values of sound payloads, none of unsound ones."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from random import Random
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.fields import ColumnReader
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.laser_scan import LASER_SCAN, MULTI_ECHO
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoders.rows import Type
from quadlog.recordings.decoding import RowReader, reader_of
from quadlog.recordings.types import TYPES
from tests.lab.decoded import decoded, together
from tests.lab.messages import KINDS, channel_of, serialised, store_of

STAMPED_TAGFRAME = "ros2_port/msg/LinktrackTagframe0"
WANTED = {name: each.wanted for name, each in TYPES.items() if isinstance(each, Type)}
WANTED |= {"sensor_msgs/msg/LaserScan": LASER_SCAN, "sensor_msgs/msg/MultiEchoLaserScan": MULTI_ECHO}
NAMES = {STAMPED_TAGFRAME: WANTED["LinktrackTagframe0"]}
NAMES |= {
    each: wanted
    for name, wanted in WANTED.items()
    for each in (name, f"nlink_parser/msg/{name}")
    if each in store_of("little").fielddefs
}
SEEDS = 2


def value_of(draw: Random, store: Any, kind: Any, detail: Any) -> Any:
    """A random value of a field, by the definition rosbags has of it."""
    if kind.name == "NAME":
        return message_of(draw, store, detail)
    if kind.name in ("SEQUENCE", "ARRAY"):
        inner, length = detail
        several = [value_of(draw, store, *inner) for _ in range(length if kind.name == "ARRAY" else draw.randrange(4))]
        return several if inner[0].name == "NAME" or inner[1][0] == "string" else np.array(several, inner[1][0])
    base = detail[0]
    if base == "string":
        return draw.choice(["map", "/odom", "base_link", "", "äß", "FL_hip_joint"])
    if base.startswith("float"):
        odd = draw.choice([0.0, -1.0, 0.5, math.nan, math.inf, draw.uniform(-1e3, 1e3), draw.uniform(-1, 1)])
        return float(np.float32(odd)) if base == "float32" else odd
    if base == "bool":
        return draw.random() < 0.5
    limits = np.iinfo(base)
    return draw.choice([0, 1, 2, int(limits.min), min(int(limits.max), 2**62), draw.randrange(100)])


def message_of(draw: Random, store: Any, name: str) -> Any:
    values = [value_of(draw, store, *descriptor) for _, descriptor in store.fielddefs[name][1]]
    return store.types[name](*values)


def at(message: Any, path: str) -> list[Any]:
    """All values at a path, by attributes."""
    path, parts = re.fullmatch(r"(.*?)(?::([a-z]*))?", path).groups("")
    head, _, rest = path.partition(".")
    name, _, count = head.partition("[")
    value = getattr(message, name)
    if count:
        several = list(value)
        if count != "]":
            several = several[: int(count[1:-1])] if count[0] == ":" else [several[int(count[:-1])]]
        return [each for one in several for each in at(one, f"{rest}:{parts}")] if rest else several
    return at(value, f"{rest}:{parts}") if rest else [getattr(value, part) for part in parts] or [value]


def expected(message: Any, choices: str) -> list[Any] | None:
    for path in choices.removesuffix("?").split("|"):
        try:
            return at(message, path.strip())
        except AttributeError:
            continue
    return None


@np.errstate(invalid="ignore")  # signalling NaN
def assert_columns_as(store: Any, channel: Channel, payloads: list[bytes], wanted: Mapping[str, str]) -> set[int]:
    """What columns hold is what rosbags' objects hold; which payloads these are."""
    read = set()
    for which, columns in ColumnReader(channel, wanted, Definitions().candidates).read(payloads):
        for i, number in enumerate(which.tolist()):
            if isinstance(columns, DecodeError):
                continue
            read.add(number)
            ros1 = channel.message_encoding == "ros1"
            deserialise = store.deserialize_ros1 if ros1 else store.deserialize_cdr
            message = deserialise(payloads[number], channel.type_name)
            for column, path in wanted.items():
                values = expected(message, path)
                assert (values is None) == (column not in columns), column
                if values is not None:
                    found = columns[column] if isinstance(columns[column], tuple) else columns[column][i].reshape(-1)
                    np.testing.assert_array_equal(found, values, column)
    return read


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", sorted(NAMES))
def test_random_messages_are_read_as_by_rosbags(name: str, kind: str) -> None:
    """Sound, padded, with bytes flipped and cut, all at once; and what they become is what each becomes alone."""
    store = store_of(kind)
    channel = channel_of(kind, name)
    for seed in range(SEEDS):
        draw = Random(seed)
        sound, other = (serialised(kind, message_of(draw, store, name)) for _ in range(2))
        flipped = bytearray(other)
        for _ in range(draw.randrange(3)):
            flipped[draw.randrange(min(len(other), 64))] = draw.choice([0, 1, 5, 0x7F, 0x80, 0xFF, draw.randrange(256)])
        cut = bytes(flipped[: draw.randrange(len(flipped))])
        payloads = [sound, other, other + bytes(draw.randrange(6)), bytes(flipped), cut, sound]
        assert {0, 1, 5} <= assert_columns_as(store, channel, payloads, NAMES[name])
        reader = reader_of(channel, Definitions(), JointOrder())
        if isinstance(reader, RowReader):
            several = together(channel.topic, reader, payloads)
            for payload, found in zip(payloads, several, strict=True):
                (alone,) = together(channel.topic, reader, [payload])
                assert isinstance(found, DecodeError) == isinstance(alone, DecodeError)
                assert repr(found) == repr(alone) or isinstance(found, DecodeError)


VERSIONS = [
    b"std_msgs/Header header\nuint8[3] more\nfloat32 x\nfloat32 y\nfloat64 z\n",
    b"string note\nstd_msgs/Header header\nfloat64 z\nfloat64 y\nfloat64 x\n",
    b"float64 x\nfloat64 y\nfloat64 z\n",
    b"std_msgs/Header header\nint64 x\nint16 y\nuint8 z\nstring[] notes\n",
    b"string x\nfloat64 y\nfloat64 z\n",
    b"float64 x\nfloat64[3] yy\nfloat64 z\n",
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("text", VERSIONS)
def test_other_definitions_of_a_standard_type_are_kept_to(text: bytes, kind: str) -> None:
    """A Point of other fields or another order inside a PoseStamped: read by its own definition, or refused."""
    name, standard, own = "geometry_msgs/msg/PoseStamped", store_of(kind).fielddefs, get_typestore(Stores.EMPTY)
    known = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Quaternion")
    own.register({each: standard[each] for each in known})
    own.register(get_types_from_msg(text.decode(), "geometry_msgs/msg/Point"))
    own.register(get_types_from_msg("Point position\nQuaternion orientation\n", "geometry_msgs/msg/Pose"))
    own.register(get_types_from_msg("std_msgs/Header header\ngeometry_msgs/Pose pose\n", name))
    channel = channel_of(kind, name, store=own)
    payload = serialised(kind, message_of(Random(0), own, name), own)
    if b"string x" in text or b" y\n" not in text:
        with pytest.raises(DecodeError, match=r"has no number pose\.position:xyz"):
            decoded(channel, payload)
    else:
        assert assert_columns_as(own, channel, [payload], TYPES[name].wanted) == {0}
