"""Payloads of standard and bundled types as rosbags writes them, and what they are decoded to, as messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.errors import DecodeError
from quadlog.messages import Batch, Message
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.ros_messages import BUNDLED, HEADER_FIELD, Definitions
from quadlog.recordings.decoders.rows import Type
from quadlog.recordings.decoding import CloudReader, RowReader, reader_of
from quadlog.recordings.plugged import messages_of

KINDS = ["ros1", "little", "big"]
CAMEL = {"motor_state": "motorState", "foot_force": "footForce", "tau_est": "tauEst", "yaw_speed": "yawSpeed"}


@cache
def store_of(kind: str) -> Any:
    """Standard and bundled types; LinkTrack's also in packages that drop or add a header, Unitree's as in ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    for path in BUNDLED.glob("*/msg/*.msg"):
        package, text, name = path.parent.parent.name, path.read_text(), path.stem
        texts = {package: text}
        if package == "nlink_parser":
            texts |= {"link_parser": text, "ros2_port": HEADER_FIELD * ("frame" in name) + text}
        if package == "ros2_unitree_legged_msgs":
            for word, camel in CAMEL.items():
                text = text.replace(word, camel)
            texts["unitree_legged_msgs"] = text
        for package, text in texts.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    if "tf2_msgs/msg/TFMessage" not in store.fielddefs:
        tf2 = "geometry_msgs/TransformStamped[] transforms\n"
        store.register(get_types_from_msg(tf2, "tf2_msgs/msg/TFMessage"))
    return store


def zeroed(kind: str, name: str, /, **values: Any) -> Any:
    """A message whose fields are zero or empty, but for these; elements of arrays can be given, too."""
    store = store_of(kind)

    def zero(what: Nodetype, detail: Any) -> Any:
        if what == Nodetype.BASE:
            return "" if detail[0] == "string" else 0.0 if detail[0].startswith("float") else 0
        if what == Nodetype.NAME:
            return store.types[detail](*(zero(*each) for _, each in store.fielddefs[detail][1]))
        (inner, of), count = detail[0], detail[1] if what == Nodetype.ARRAY else 0
        several = [zero(inner, of) for _ in range(count)]
        return np.array(several, of[0]) if inner == Nodetype.BASE and of[0] != "string" else several

    message = zero(Nodetype.NAME, name)
    for field, value in values.items():
        known = getattr(message, field)
        setattr(message, field, np.array(value, known.dtype) if isinstance(known, np.ndarray) else value)
    return message


def serialised(kind: str, message: Any, store: Any = None) -> bytes:
    store, name = store or store_of(kind), message.__msgtype__
    if kind == "ros1":
        return bytes(store.serialize_ros1(message, name))
    return bytes(store.serialize_cdr(message, name, little_endian=kind == "little"))


def channel_of(kind: str, name: str, *, embedded: bool = True, store: Any = None) -> Channel:
    encoding, version = ("ros1", 1) if kind == "ros1" else ("cdr", 2)
    text = (store or store_of(kind)).generate_msgdef(name, ros_version=version)[0] if embedded else ""
    return Channel("/uwb/n_3", name, encoding, f"ros{version}msg" if embedded else "", text.encode())


def decoded(
    channel: Channel,
    payload: bytes,
    definitions: Definitions | None = None,
    order: JointOrder | None = None,
    mapped: Mapping[str, Type] | None = None,
) -> tuple[Message, ...]:
    """The messages of one payload. Raises DecodeError."""
    reader = reader_of(channel, definitions or Definitions(), order or JointOrder(), mapped)
    assert reader is not None
    if isinstance(reader, CloudReader):
        cloud = reader.decode(payload, True)
        return () if cloud is None else (cloud,)
    (found,) = together(channel.topic, reader, [payload])
    if isinstance(found, DecodeError):
        raise found
    return found


def together(topic: str, reader: RowReader, payloads: Sequence[bytes]) -> list[tuple[Message, ...] | DecodeError]:
    """What becomes of each payload where all are read at once."""
    found: list[list[Message]] = [[] for _ in payloads]
    why: dict[int, str] = {}

    def batches() -> Iterator[Batch]:
        for each in reader.read(payloads):
            kept = set()
            for part in each.parts:
                of = np.arange(len(each.which)) if part.of is None else part.of
                part.rows["order"] = each.which[of]
                kept |= set(of.tolist())
                stamps = None if part.stamp_ns is None else part.stamp_ns[of]
                frames = part.frames or ("", "")
                yield Batch(part.kind, topic, part.rows, part.rows["t_ns"], stamps, *frames, part.unmeasured)
            lost = [number for i, number in enumerate(each.which.tolist()) if each.failed and i not in kept]
            assert len(lost) == each.failed
            why.update(dict.fromkeys(lost, each.why))

    for order, _, _, message in messages_of(batches()):
        found[order].append(message)
    return [DecodeError(topic, why[i]) if i in why else tuple(each) for i, each in enumerate(found)]
