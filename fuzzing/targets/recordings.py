"""Containers, their damage, split folders, definitions and payloads."""

from __future__ import annotations

import json
from collections import deque
from contextlib import suppress
from functools import cache
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

from fuzzing import seeds
from fuzzing.edits import edited
from fuzzing.oracles import command, expect, replaced
from quadlog.errors import ExitCode, NothingReadable
from quadlog.recordings.containers.container import Budget, Channel, Damaged
from quadlog.recordings.containers.open import open_container
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoding import CloudReader, RowReader, reader_of
from quadlog.recordings.survey import indexed_times

READ = (ExitCode.DONE, ExitCode.WITH_LOSS, ExitCode.FAILED)
_MOST_MESSAGES = 1_000_000


def containers(folder: Path, data: bytes) -> None:
    """Any bytes: read raw, by index, in part, then through `info`, which decodes all that it knows."""
    path = folder / "case"
    path.write_bytes(data)
    with open_container(path) as container:
        with suppress(Damaged):  # no usable index
            indexed_times(container)
        part = container.excerpt(Budget(places=2, stored_bytes=500, messages=8))
        with suppress(NothingReadable):  # elsewhere there may be more
            deque(() if part is None else islice(part.messages(), _MOST_MESSAGES), maxlen=0)
        for _ in islice(container.messages(), _MOST_MESSAGES):
            pass
    if crc32(data) % 16 == 0:  # a hundred times as slow
        _, out = command("info", path, "--json", allowed=READ)
        json.loads(out or "{}")


def container_seeds() -> list[bytes]:
    """One of each kind."""
    return list(seeds.recordings().values())


def damage(folder: Path, data: bytes) -> None:
    """A known recording after edits, made before it is opened or, by the first byte's highest bit, afterwards.

    No message is read that was not in it, what is missing is a loss, reading it again changes neither, and nothing
    is written beside it.
    """
    kind = (data or b"\0")[0]
    name, sound = list(seeds.recordings().items())[kind % 0x80 % len(seeds.recordings())]
    damaged = edited(sound, data[1:])
    path = folder / "case"
    path.write_bytes(sound if kind & 0x80 else damaged)
    with open_container(path) as container:
        path.write_bytes(damaged)
        found = sum(1 for _ in container.messages())
        expect(found <= seeds.MESSAGES, f"{name}: {found} messages of {seeds.MESSAGES}")
        missing = found < seeds.MESSAGES
        expect(not missing or bool(container.losses), f"{name}: {found} of {seeds.MESSAGES} messages, no loss")
        again = sum(1 for _ in container.messages())
        expect(again == found, f"{name}: {found} messages, {again} when read again")
        expect(len(set(container.losses)) == len(container.losses), f"{name}: a loss is reported twice")
        expect([each.name for each in folder.iterdir()] == [path.name], f"{name}: a file was written beside it")
    if missing and crc32(data) % 16 == 0:
        code, _ = command("info", path, "--json", allowed=READ)
        expect(code is not ExitCode.DONE, f"{name}: info exits with 0 for {found} of {seeds.MESSAGES} messages")


def damage_seeds() -> list[bytes]:
    """Each kind with nothing done to it, and with its end cut off before and after it is opened."""
    kinds = range(len(seeds.recordings()))
    cut = bytes([7, 0, 0xA0, 0x0F, 0, 0])
    return [bytes([kind]) + edit for kind in kinds for edit in (b"", cut)] + [
        bytes([0x80 | kind]) + cut for kind in kinds
    ]


def split(folder: Path, data: bytes) -> None:
    """A folder of two sound parts beside any metadata.yaml, which is a help and never a condition."""
    whole = folder / "walk"
    if not whole.exists():
        whole.mkdir()
        seeds.write_split(whole)
    with replaced(whole / "metadata.yaml", data):
        with open_container(whole) as container:
            found = sum(1 for _ in container.messages())
            expect(found <= seeds.MESSAGES, f"{found} of {seeds.MESSAGES} messages")
            expect(found == seeds.MESSAGES or bool(container.losses), f"{found} of {seeds.MESSAGES} messages, no loss")
        if found < seeds.MESSAGES and crc32(data) % 16 == 0:
            code, _ = command("info", whole, "--json", allowed=READ)
            expect(code is not ExitCode.DONE, f"info exits with 0 for {found} of {seeds.MESSAGES} messages")


def split_seeds() -> list[bytes]:
    """What the recorder wrote, in blocks and with an older version's fields."""
    with TemporaryDirectory() as folder:
        text = seeds.write_split(Path(folder)).encode()
    return [text, text.replace(b"version: 5", b"version: 1"), b""]


SPLIT_TOKENS = (*b".inf|1e300|&a |*a|<<: |!!int |!!binary |? |- |[|{|zstd|FILE".split(b"|"),)


_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/Imu",
    "tf2_msgs/msg/TFMessage",
    "nlink_parser/msg/LinktrackTagframe0",
    "sensor_msgs/msg/Range",
)
_DEFINED = (("ros1", "ros1msg"), ("cdr", "ros2msg"), ("cdr", "ros2idl"))


def definitions(folder: Path, data: bytes) -> None:
    """Any text as a type's definition, and a payload of it: bytes type, encoding, length of the payload."""
    if len(data) < 3:
        return
    encoding, schema = _DEFINED[data[1] % len(_DEFINED)]
    payload, text = data[3 : 3 + data[2]], data[3 + data[2] :]
    channel = Channel("/t", _TYPES[data[0] % len(_TYPES)], encoding, schema, text)
    _read(reader_of(channel, Definitions(), JointOrder()), payload)
    Definitions().deserialiser(channel)(payload)


def _read(reader: RowReader | CloudReader | None, payload: bytes) -> None:
    """Every payload becomes a cloud, rows, or a reason."""
    if isinstance(reader, CloudReader):
        expect(reader.decode(payload, True) is not None, "a decoder gives nothing")
    elif reader is not None:
        (found,) = reader.read([payload])
        expect(found.failed == 0 or bool(found.why), "a payload is refused without a reason")


def definition_seeds() -> list[bytes]:
    """The real definitions of both generations with a real payload, and one in IDL."""
    idl = (
        b"module geometry_msgs { module msg {\n  struct PoseStamped {\n    sequence<double> a;\n    string<5> b;\n"
        b'    double c[3];\n    @verbatim (language="comment", text="x")\n    octet d;\n  };\n};};\n'
    )
    found = [bytes([0, 2, 8]) + bytes(8) + idl]
    for ros in (1, 2):
        for each in seeds.encoded(ros):
            if each.type_name in _TYPES and len(each.payload) < 256:
                head = bytes([_TYPES.index(each.type_name), ros - 1, len(each.payload)])
                found.append(head + each.payload + each.definition[0].encode())
    return found


DEFINITION_TOKENS = (
    b"\n" + b"=" * 80 + b"\nMSG: ",
    *b"float64|string|uint8[]|[4096]|[<=3]|string<=9|wstring|time|duration|Header|geometry_msgs/Pose".split(b"|"),
    *b"int32 A=1\n|int8 x -3\n|sequence<|struct |module |typedef |const |enum |union |@default (value=1)".split(b"|"),
    *b"#include|IDL: |[4294967295]".split(b"|"),
)


@cache
def _channels() -> tuple[Channel, ...]:
    from foxglove import messages

    found = []
    for ros in (1, 2):
        for each in seeds.encoded(ros):
            text = each.definition[0].encode()
            found.append(Channel(each.topic, each.type_name, *_DEFINED[ros - 1], text))
    bare = ("gtec_msgs/msg/Ranging", "uwb_driver/msg/UwbRange", "livox_ros_driver2/msg/CustomMsg")
    bare += ("nlink_parser/msg/LinktrackNodeframe2", "nlink_parser/msg/LinktrackAnchorframe0", "sensor_msgs/msg/Range")
    found += [Channel("/uwb_3", name, encoding, "", b"") for name in bare for encoding in ("ros1", "cdr")]
    for name in ("foxglove.PointCloud", "foxglove.PoseInFrame"):
        found.append(Channel("/j", name, "json", "jsonschema", b"{}"))
        schema = getattr(messages, name.rpartition(".")[2]).get_schema()
        found.append(Channel("/p", name, "protobuf", "protobuf", bytes(schema.data)))
    return tuple(found)


@cache
def _readers() -> list[RowReader | CloudReader | None]:
    return [reader_of(channel, Definitions(), JointOrder()) for channel in _channels()]


def payloads(folder: Path, data: bytes) -> None:
    """Any bytes as a message of the channel that the first one chooses."""
    _read(_readers()[(data or b"\0")[0] % len(_readers())], data[1:])


def payload_seeds() -> list[bytes]:
    """A real payload where there is one, and nothing elsewhere."""
    kinds = [each.payload for ros in (1, 2) for each in seeds.encoded(ros)]
    kinds += [b""] * (len(_channels()) - len(kinds))
    pose = b'{"timestamp":{"sec":1,"nsec":2},"frame_id":"a","pose":{"position":{"x":1},"orientation":{"w":1}}}'
    cloud = (
        b'{"timestamp":{"sec":1,"nsec":2},"frame_id":"a","point_stride":12,"data":"AAAAAAAAAAAAAAAA",'
        b'"fields":[{"name":"x","offset":0,"type":7},{"name":"y","offset":4,"type":7},{"name":"z","offset":8,"type":7}]}'
    )
    extra = [bytes([i]) + text for i, each in enumerate(_channels()) if each.topic == "/j" for text in (pose, cloud)]
    return [bytes([i]) + payload for i, payload in enumerate(kinds)] + extra


PAYLOAD_TOKENS = (*b'1e400 NaN null [] {} "x":'.split(), b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f", b"\0\0\0\0\0\0\xf8\x7f")
