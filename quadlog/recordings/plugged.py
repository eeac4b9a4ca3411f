"""Decoders of plug-ins: their interface, and the validation of the messages they return."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import (
    NO_ID,
    ROWS,
    Batch,
    Float,
    Imu,
    Message,
    PointCloud,
    Pose,
    Transforms,
    UwbRanges,
)
from quadlog.plugins import Plugin, foreign_code
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
    lengths, arrays = set[int](), dict[str, Float]()
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
    """The rows of a message, in parts: one for each transform, one for all other kinds."""
    if isinstance(message, Transforms):
        for index, each in enumerate(message.transforms):
            (made,) = parts_of(each)
            values: dict[str, Any] = {"index": index} | {name: made.rows[name] for name in _fields_of(Pose)}
            yield part(Transforms, 1, **values)._replace(stamp_ns=made.stamp_ns, frames=made.frames)
        return
    given: dict[str, Any] = {name: getattr(message, name) for name in _fields_of(type(message))}
    n, of, why = 1, None, ""
    if isinstance(message, UwbRanges):
        # One that was not measured is left out of the arrays.
        n, why = len(message.anchor) or bool(message.unmeasured), message.unmeasured
        of, given = (
            np.zeros(n, np.int64),
            {name: each for name, each in given.items() if name == "tag" or np.size(each)},
        )
        given = {"first_path_gap_db": None} | {name: each for name, each in given.items() if each is not None}
        given["tag"] = NO_ID if message.tag is None else message.tag
    filled: dict[str, Any] = {name: np.nan if each is None else each for name, each in given.items()}
    stamps = None if message.stamp_ns is None else np.array([message.stamp_ns])
    frames = getattr(message, "frame_id", ""), getattr(message, "child_frame_id", "")
    yield part(type(message), n, of=of, unmeasured=why, **filled)._replace(stamp_ns=stamps, frames=frames)


def messages_of(batches: Iterable[Batch]) -> Iterator[tuple[int, int, str, Message]]:
    """Order, time, topic and message for each message of complete batches, by order."""
    found: dict[tuple[int, int], list[tuple[int, str, Any]]] = {}
    kinds = list(ROWS)
    for batch in batches:
        for at, message in _unpacked(batch):
            row = batch.rows[at]
            key = int(row["order"]), kinds.index(batch.kind)
            found.setdefault(key, []).append((int(row["t_ns"]), batch.topic, message))
    for order, kind in sorted(found):
        several = found[order, kind]
        if kinds[kind] is Transforms:
            t_ns, topic, first = several[0]
            several = [(t_ns, topic, Transforms(first.stamp_ns, tuple(each for *_, each in several), is_static(topic)))]
        yield from ((order, *each) for each in several)


def _unpacked(batch: Batch) -> Iterator[tuple[int, Message]]:
    """The messages of a batch, each with the number of its first row; transforms as poses."""
    rows, kind = batch.rows, Pose if batch.kind is Transforms else batch.kind
    names = [name for name in _fields_of(kind) if name in (rows.dtype.names or ())]
    starts, ends = list(range(len(rows))), None
    if kind is UwbRanges:
        ids = np.column_stack([rows["order"], rows["tag"]])
        starts = np.flatnonzero(np.diff(ids, axis=0, prepend=ids[:1] - 1).any(axis=1)).tolist()
        ends = [*starts[1:], len(rows)]
    for i, at in enumerate(starts):
        fields: dict[str, Any] = {"stamp_ns": None if batch.stamp_ns is None else int(batch.stamp_ns[at])}
        fields |= {name: getattr(batch, name) for name in ("frame_id", "child_frame_id") if name in kind.__slots__}
        if ends is not None:
            some = rows[at:at] if batch.unmeasured else rows[at : ends[i]]
            fields |= {name: some[name].copy() for name in names} | {"unmeasured": batch.unmeasured}
            fields["tag"] = None if (tag := int(rows["tag"][at])) == NO_ID else tag
        else:
            fields |= {name: rows[name][at].astype(np.float64) for name in names}
        for name in ("first_path_gap_db", "quat_xyzw"):
            if name in fields and np.isnan(fields[name]).all():
                fields[name] = None
        yield at, kind(**fields)
