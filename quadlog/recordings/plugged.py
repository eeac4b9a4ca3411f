"""Decoders of plug-ins: their interface, and the validation of the messages they return."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from quadlog.config.plugins import Plugin, foreign_code
from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import (
    NO_ID,
    ROWS,
    Batch,
    Float,
    Imu,
    JointStates,
    Message,
    Odometry,
    PointCloud,
    Pose,
    Transforms,
    UwbRanges,
)
from quadlog.recordings.containers.container import MAX_TIME_NS
from quadlog.recordings.decoders.rows import Part, part, unit_rows
from quadlog.recordings.types import is_static

Interpret = Callable[[Any, str], tuple[Message, ...]]

_CLOUD: dict[str, tuple[DTypeLike, tuple[int, ...]]] = {
    "xyz_m": (np.float32, (3,)),
    "ring": (np.uint16, ()),
    "offset_ns": (np.int64, ()),
}
_MAY_BE_NONE = {"ring", "offset_ns", "first_path_gap_db", "anchor_position_m"}


@dataclass(frozen=True, slots=True)
class MessageDecoder:
    """What an entry point of the group `quadlog.decoders` names; the entry point's own name is the message type.

    gives: one of the classes of `quadlog.messages`; it decides which roles a topic of the type can play.
    decode: called with a message and its topic. The message is what the recording's definition makes of a payload:
    an object with the fields of a ROS message (arrays of numbers are numpy's) or of a protobuf one, or the dict of a
    JSON one. Gives none, one or several of `gives`; whatever it raises counts as a message that could not be decoded.
    """

    gives: type[Message]
    decode: Callable[[Any, str], Iterable[Message]]


def check_decoder(plugin: Plugin, found: Any) -> MessageDecoder:
    """What an entry point names, as the decoder it has to be. Raises QuadlogError, which says what is wrong."""
    if not isinstance(found, MessageDecoder):
        raise plugin.unusable(f"is no MessageDecoder but {type(found).__name__}")
    if found.gives not in (PointCloud, *ROWS):
        known = ", ".join(each.__name__ for each in (PointCloud, *ROWS))
        raise plugin.unusable(f"gives {getattr(found.gives, '__name__', found.gives)}, which is not one of {known}")
    return found


def interpreter(decoder: MessageDecoder) -> Interpret:
    """Its decode, with arrays of the types that quadlog computes with. Raises DecodeError for whatever goes wrong."""

    def interpret(message: Any, topic: str) -> tuple[Message, ...]:
        with foreign_code(lambda failure: DecodeError(topic, f"its plug-in failed: {failure}")):
            return tuple(_sound(each, decoder.gives, topic) for each in decoder.decode(message, topic))

    return interpret


def _sound(message: Any, gives: type[Message], topic: str) -> Message:
    """The message as quadlog's own decoders give it. Raises DecodeError, or what a field of another kind raises."""
    if not isinstance(message, gives):
        raise DecodeError(topic, f"its plug-in gave {type(message).__name__} instead of {gives.__name__}")
    sound: dict[str, Any] = {
        name: None if (value := getattr(message, name)) is None else operator.index(value)
        for name in ("stamp_ns", "tag")
        if hasattr(message, name)
    }
    for name, number in sound.items():
        if number is not None and not -MAX_TIME_NS <= number <= MAX_TIME_NS:
            raise DecodeError(topic, f"its plug-in gave a {name} of {number}, which does not fit into 64 bits")
    for name in ("frame_id", "child_frame_id"):
        if not isinstance(getattr(message, name, ""), str):
            raise DecodeError(topic, f"its plug-in gave a {name} that is no text")
    if isinstance(message, Transforms):
        sound["transforms"] = tuple(_sound(each, Pose, topic) for each in message.transforms)
    sound |= _sound_arrays(message, gives, topic)
    return replace(message, **sound)


def _sound_arrays(message: Any, gives: type[Message], topic: str) -> dict[str, Float]:
    """Its arrays by name, of the right type and shape; positions are within reach, rotations of unit length.

    Raises DecodeError, ValueError.
    """
    several, wanted = gives in (PointCloud, UwbRanges), dict(_CLOUD if gives is PointCloud else {})
    for name in () if gives in (PointCloud, Transforms) else _fields_of(gives):
        dtype = ROWS[gives][name]
        if name not in ("tag", "tick"):  # numbers of joints as they come; their rows have half of the bits
            wanted[name] = np.float64 if dtype.base.kind == "f" else dtype.base, dtype.shape
    lengths, arrays = set(), {}
    for name, (kind, shape) in wanted.items():
        value = getattr(message, name)
        if value is None and (name in _MAY_BE_NONE or (gives, name) == (Imu, "quat_xyzw")):
            continue
        array = np.asarray(value, dtype=kind)
        if array.ndim != len(shape) + several or array.shape[several:] != shape:
            raise DecodeError(topic, f"its plug-in gave {name} of shape {array.shape}, not {('N',) * several + shape}")
        lengths |= {len(array)} if several else set()
        if name == "position_m" and not (np.abs(array) <= FARTHEST_M).all():
            raise DecodeError(topic, f"its position is not finite, or beyond {FARTHEST_M:.0e} m")
        if name == "quat_xyzw":
            unit, finite = unit_rows(array[None])
            if not finite.all():
                raise DecodeError(topic, "its quaternion is not finite")
            array = unit[0]
        arrays[name] = array
    if len(lengths) > 1:
        raise DecodeError(topic, f"its plug-in gave arrays of lengths {sorted(lengths)}")
    return arrays


def _fields_of(kind: type[Message]) -> tuple[str, ...]:
    """Fields of a kind's rows that its messages have too."""
    return (ROWS[kind].names or ())[2:]


def parts_of(message: Message) -> Iterator[Part]:
    """A message as rows; of transforms a part for each."""
    if isinstance(message, Transforms):
        for index, each in enumerate(message.transforms):
            values = {"position_m": each.position_m, "quat_xyzw": each.quat_xyzw, "index": index}
            yield _of_one(part(Transforms, 1, **values), each)
    elif isinstance(message, UwbRanges):
        # One that was not measured is left out of the arrays.
        n, why = len(message.anchor) or bool(message.unmeasured), message.unmeasured
        values = {name: getattr(message, name) for name in _fields_of(UwbRanges)}
        values["tag"] = NO_ID if message.tag is None else message.tag
        given = {name: each for name, each in values.items() if each is not None and (name == "tag" or len(each))}
        made = part(UwbRanges, n, of=np.zeros(n, np.int64), unmeasured=why, **{"first_path_gap_db": np.nan} | given)
        yield _of_one(made, message)
    else:
        values = {name: np.nan if (v := getattr(message, name)) is None else v for name in _fields_of(type(message))}
        yield _of_one(part(type(message), 1, **values), message)


def _of_one(made: Part, message: Any) -> Part:
    frames = getattr(message, "frame_id", ""), getattr(message, "child_frame_id", "")
    return made._replace(stamp_ns=None if message.stamp_ns is None else np.array([message.stamp_ns]), frames=frames)


def messages_of(batches: Iterable[Batch]) -> Iterator[tuple[int, int, str, Message]]:
    """Order, time, topic and message for each message of complete batches, by order."""
    found: dict[tuple[int, int], list[tuple[int, str, Any]]] = {}
    kinds = list(ROWS)
    for batch in batches:
        for at, message in _unpacked(batch):
            row = batch.rows[at]
            key = int(row["order"]), kinds.index(batch.kind)
            found.setdefault(key, []).append((int(row["t_ns"]), batch.topic, message))
    for (order, kind), several in sorted(found.items()):
        if kinds[kind] is Transforms:
            t_ns, topic, first = several[0]
            poses = tuple(pose for _, _, pose in several)
            several = [(t_ns, topic, Transforms(first.stamp_ns, poses, is_static(topic)))]
        yield from ((order, *each) for each in several)


def _unpacked(batch: Batch) -> Iterator[tuple[int, Message]]:
    """The messages of a batch, each with the number of its first row; transforms as poses."""
    rows, kind, frames = batch.rows, batch.kind, (batch.frame_id, batch.child_frame_id)
    stamps = [None] * len(rows) if batch.stamp_ns is None else batch.stamp_ns.tolist()
    if kind is UwbRanges:
        ids = np.column_stack([rows["order"], rows["tag"]])
        starts = np.flatnonzero(np.diff(ids, axis=0, prepend=ids[:1] - 1).any(axis=1)).tolist()
        for at, end in pairwise([*starts, len(rows)]):
            tag, some = int(rows["tag"][at]), rows[at:at] if batch.unmeasured else rows[at:end]
            values = {name: some[name].copy() for name in rows.dtype.names[3:]}
            if np.isnan(values["first_path_gap_db"]).all():
                values["first_path_gap_db"] = None
            tag = None if tag == NO_ID else tag
            yield at, UwbRanges(stamps[at], tag, **values, unmeasured=batch.unmeasured)
        return
    for at, (row, stamp) in enumerate(zip(rows, stamps, strict=True)):
        values = {name: row[name].astype(np.float64) for name in rows.dtype.names[2:] if name != "index"}
        if kind is Imu:
            turn = values.pop("quat_xyzw")
            yield at, Imu(stamp, frames[0], None if np.isnan(turn).any() else turn, **values)
        elif kind is JointStates:
            yield at, JointStates(stamp, **values | {"tick": float(values["tick"])})
        else:
            yield at, (Odometry if kind is Odometry else Pose)(stamp, *frames, **values)
