"""Decoders of plug-ins: their interface, and the validation of the messages they return."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import (
    NO_ID,
    ROWS,
    Batch,
    Imu,
    Message,
    PointCloud,
    Pose,
    Transforms,
    UwbRanges,
)
from quadlog.plugins import Plugin, foreign_code
from quadlog.recordings.containers.container import MAX_TIME_NS
from quadlog.recordings.decoders.rows import part, unit_rows
from quadlog.recordings.tf_tree import is_static

_CLOUD = np.dtype([("xyz_m", "f4", 3), ("ring", "u2"), ("offset_ns", "i8")])
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


def interpreter(decoder: MessageDecoder, failed: str = "its plug-in failed") -> Callable[[Any, str], list[Any]]:
    """From a message and its topic to the rows, or clouds, of what decode makes of it.

    Raises DecodeError for whatever goes wrong, with `failed` before it.
    """

    def interpret(message: Any, topic: str) -> list[Any]:
        with foreign_code(lambda failure: DecodeError(topic, f"{failed}: {failure}")):
            return [made for each in decoder.decode(message, topic) for made in parts_of(each, decoder.gives, topic)]

    return interpret


def _sound(message: Any, gives: type[Message], topic: str) -> dict[str, Any]:
    """A message's numbers and arrays by name, of the right type and shape; positions are within reach, rotations of
    unit length. Raises DecodeError, or what a field of another kind raises.
    """
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
    several, lengths = gives in (PointCloud, UwbRanges), set[int]()
    for name in _fields_of(gives):
        value, wanted = getattr(message, name), _CLOUD[name] if gives is PointCloud else ROWS[gives][name]
        if name in sound or (value is None and (name in _MAY_BE_NONE or (gives, name) == (Imu, "quat_xyzw"))):
            continue
        array = np.asarray(value, dtype=wanted.base)
        if array.ndim != len(wanted.shape) + several or array.shape[several:] != wanted.shape:
            shape = ("N",) * several + wanted.shape
            raise DecodeError(topic, f"its plug-in gave {name} of shape {array.shape}, not {shape}")
        lengths |= {len(array)} if several else set()
        if name == "position_m" and not (np.abs(array) <= FARTHEST_M).all():
            raise DecodeError(topic, f"its position is not finite, or beyond {FARTHEST_M:.0e} m")
        if name == "quat_xyzw":
            (array,), finite = unit_rows(array[None])
            if not finite.all():
                raise DecodeError(topic, "its quaternion is not finite")
        sound[name] = array
    if len(lengths) > 1:
        raise DecodeError(topic, f"its plug-in gave arrays of lengths {sorted(lengths)}")
    return sound


def _fields_of(kind: type[Message]) -> tuple[str, ...]:
    """Fields of a kind's rows, or of a cloud, that its messages have too."""
    return () if kind is Transforms else _CLOUD.names or () if kind is PointCloud else (ROWS[kind].names or ())[2:]


def parts_of(message: Any, gives: type[Message], topic: str) -> Iterator[Any]:
    """A sound cloud, or the rows of a message: a Part for each transform, one for all other kinds. Raises as _sound."""
    values = _sound(message, gives, topic)
    if isinstance(message, PointCloud):
        yield replace(message, **values)
    elif isinstance(message, Transforms):
        for index, each in enumerate(message.transforms):
            (made,) = parts_of(each, Pose, topic)
            rows: dict[str, Any] = {name: made.rows[name] for name in _fields_of(Pose)}
            yield made._replace(kind=Transforms, rows=part(Transforms, 1, index=index, **rows).rows)
    else:
        stamp_ns, n, of, why = values.pop("stamp_ns"), 1, None, ""
        if isinstance(message, UwbRanges):
            # One that was not measured is left out of the arrays.
            n, why = len(values["anchor"]) or int(bool(message.unmeasured)), message.unmeasured
            of, values = np.zeros(n, np.int64), {name: each for name, each in values.items() if np.size(each)}
            values = {"first_path_gap_db": np.nan} | values
            values["tag"] = NO_ID if values["tag"] is None else values["tag"]
        elif isinstance(message, Imu):
            values = {"quat_xyzw": np.nan} | values
        frames = getattr(message, "frame_id", ""), getattr(message, "child_frame_id", "")
        stamps = None if stamp_ns is None else np.array([stamp_ns])
        yield part(gives, n, of=of, unmeasured=why, **values)._replace(stamp_ns=stamps, frames=frames)


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
