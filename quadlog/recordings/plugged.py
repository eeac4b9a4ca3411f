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
from quadlog.messages import (
    NO_ID,
    ROWS,
    UNPLACED,
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
from quadlog.recordings.decoders.pose import normalised, within_reach
from quadlog.recordings.decoders.rows import Part
from quadlog.recordings.types import is_static

Interpret = Callable[[Any, str], tuple[Message, ...]]

# Field -> what it holds and its shape; letters stand for a length that is the same in all fields.
_ARRAYS: dict[type, dict[str, tuple[DTypeLike, tuple[int | str, ...]]]] = {
    PointCloud: {"xyz_m": (np.float32, ("n", 3)), "ring": (np.uint16, ("n",)), "offset_ns": (np.int64, ("n",))},
    UwbRanges: {
        "anchor": (np.int64, ("k",)),
        "range_m": (np.float64, ("k",)),
        "first_path_gap_db": (np.float64, ("k",)),
        "anchor_position_m": (np.float64, ("k", 3)),
    },
    Pose: {"position_m": (np.float64, (3,)), "quat_xyzw": (np.float64, (4,))},
    Odometry: {
        "position_m": (np.float64, (3,)),
        "quat_xyzw": (np.float64, (4,)),
        "linear_mps": (np.float64, (3,)),
        "angular_radps": (np.float64, (3,)),
    },
    Imu: {"quat_xyzw": (np.float64, (4,)), "angular_radps": (np.float64, (3,)), "linear_mps2": (np.float64, (3,))},
    Transforms: {},
    JointStates: {
        "position_rad": (np.float64, (12,)),
        "velocity_radps": (np.float64, (12,)),
        "torque_nm": (np.float64, (12,)),
        "foot_force_n": (np.float64, (4,)),
    },
}
_MAY_BE_NONE = {
    (PointCloud, "ring"),
    (PointCloud, "offset_ns"),
    (UwbRanges, "first_path_gap_db"),
    (UwbRanges, "anchor_position_m"),
    (Imu, "quat_xyzw"),
}


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
    if found.gives not in _ARRAYS:
        known = ", ".join(each.__name__ for each in _ARRAYS)
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
    lengths: dict[str, int] = {}
    arrays = {}
    for name, (kind, shape) in _ARRAYS[gives].items():
        value = getattr(message, name)
        if value is None and (gives, name) in _MAY_BE_NONE:
            continue
        array = np.asarray(value, dtype=kind)
        length = len(array) if array.ndim else 0
        wanted = tuple(lengths.setdefault(each, length) if isinstance(each, str) else each for each in shape)
        if array.shape != wanted:
            raise DecodeError(topic, f"its plug-in gave {name} of shape {array.shape}, not {wanted}")
        if name == "position_m":
            x, y, z = array.tolist()
            within_reach(x, y, z, topic)
        arrays[name] = normalised(array.tolist(), topic) if name == "quat_xyzw" else array
    return arrays


def parts_of(message: Message) -> Iterator[Part]:
    """A message as rows; of transforms a part for each."""
    if isinstance(message, Transforms):
        for index, each in enumerate(message.transforms):
            (part,) = parts_of(each)
            rows = np.zeros(1, ROWS[Transforms])
            for name in ("position_m", "quat_xyzw"):
                rows[name] = part.rows[name]
            rows["index"] = index
            yield part._replace(kind=Transforms, rows=rows)
        return
    dtype, n, of = ROWS[type(message)], 1, None
    if isinstance(message, UwbRanges):
        dtype = UNPLACED if message.anchor_position_m is None else dtype
        # One that was not measured is left out of the arrays.
        n = len(message.anchor) or bool(message.unmeasured)
        of = np.zeros(n, np.int64)
    rows = np.full(n, NO_ID, dtype)
    for name in rows.dtype.names[2:] if n else ():
        value = getattr(message, name)
        if value is None or np.size(value):
            rows[name] = (NO_ID if name == "tag" else np.nan) if value is None else value
    stamps = None if message.stamp_ns is None else np.array([message.stamp_ns])
    frames = getattr(message, "frame_id", ""), getattr(message, "child_frame_id", "")
    yield Part(type(message), rows, of, stamps, frames, getattr(message, "unmeasured", ""))


def messages_of(batches: Iterable[Batch]) -> Iterator[tuple[int, int, str, Message]]:
    """Order, time, topic and message for each message of complete batches, by order."""
    found: dict[tuple[int, str], list[tuple[int, Message]]] = {}
    topics = {}
    for batch in batches:
        for at, message in _unpacked(batch):
            order = int(batch.rows["order"][at])
            topics[order] = batch.topic
            found.setdefault((order, batch.kind.__name__), []).append((int(batch.rows["t_ns"][at]), message))
    for (order, kind), several in sorted(found.items(), key=lambda each: each[0][0]):
        if kind == Transforms.__name__:
            poses = tuple(message for _, message in several)
            several = [(several[0][0], Transforms(poses[0].stamp_ns, poses, is_static(topics[order])))]
        for t_ns, message in several:
            yield order, t_ns, topics[order], message


def _unpacked(batch: Batch) -> Iterator[tuple[int, Message]]:
    """The messages of a batch, each with the number of its first row; transforms as poses."""
    rows, kind, frames = batch.rows, batch.kind, (batch.frame_id, batch.child_frame_id)
    stamps = [None] * len(rows) if batch.stamp_ns is None else batch.stamp_ns.tolist()
    if kind is UwbRanges:
        ids = np.column_stack([rows["order"], rows["tag"]])
        starts = np.flatnonzero(np.diff(ids, axis=0, prepend=ids[:1] - 1).any(axis=1)).tolist()
        for at, end in pairwise([*starts, len(rows)]):
            some = rows[at:end]
            tag, some = int(some["tag"][0]), some[:0] if batch.unmeasured else some
            gap_db = None if np.isnan(some["first_path_gap_db"]).all() else some["first_path_gap_db"].copy()
            places = some["anchor_position_m"].copy() if "anchor_position_m" in rows.dtype.names else None
            columns = some["anchor"].copy(), some["range_m"].copy(), gap_db, places
            yield at, UwbRanges(stamps[at], None if tag == NO_ID else tag, *columns, batch.unmeasured)
        return
    for at, (row, stamp) in enumerate(zip(rows, stamps, strict=True)):
        values = {name: row[name].astype(np.float64) for name in rows.dtype.names[2:]}
        if kind is Imu:
            if np.isnan(values["quat_xyzw"]).any():
                values["quat_xyzw"] = None
            yield at, Imu(stamp, batch.frame_id, **values)
        elif kind is JointStates:
            yield at, JointStates(stamp, **values | {"tick": float(values["tick"])})
        elif kind is Odometry:
            yield at, Odometry(stamp, *frames, **values)
        else:
            yield at, Pose(stamp, *frames, values["position_m"], values["quat_xyzw"])
