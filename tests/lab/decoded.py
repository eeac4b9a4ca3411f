"""What payloads are decoded to, as messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Batch, Message
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoders.rows import Type
from quadlog.recordings.decoding import CloudReader, RowReader, reader_of
from quadlog.recordings.plugged import messages_of


def decoded(
    channel: Channel, payload: bytes, order: JointOrder | None = None, mapped: Mapping[str, Type] | None = None
) -> tuple[Message, ...]:
    """The messages of one payload. Raises DecodeError."""
    reader = reader_of(channel, Definitions(), order or JointOrder(), mapped)
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
