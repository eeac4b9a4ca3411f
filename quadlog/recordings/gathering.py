"""Small messages that wait until there are enough of them to be decoded at once, and what becomes of them."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quadlog.messages import Int, Message
from quadlog.recordings.clock import Clock
from quadlog.recordings.containers.container import Channel, RawMessage
from quadlog.recordings.decoders.columns import LARGEST_BYTES, ColumnDecoder, Columns, Ways
from quadlog.recordings.decoders.ros_messages import Definitions

MOST_WAITING, MOST_WAITING_BYTES = 4096, 1 << 20
MOST_TRIES = 8
"""So many broken payloads in a row say that no layout will be found."""


class One(NamedTuple):
    """A message at an instant on the chosen clock.

    order: a number that grows with log time, since columns may come later than single messages of their topic.
    """

    order: int
    t_ns: int
    topic: str
    message: Message


class Many(NamedTuple):
    """Columns of N messages of a topic, at instants (N,) on the chosen clock; order (N,) as in One."""

    order: Int
    t_ns: Int
    topic: str
    columns: Columns


Gathered = One | Many


@dataclass
class Pass:
    """One reading of some topics, of instants with start_ns <= t_ns < end_ns; None where it is open.

    failed, zeros: topic -> messages met that could not be decoded, and stamps of 0.
    """

    start_ns: int | None = None
    end_ns: int | None = None
    failed: dict[str, int] = field(default_factory=dict)
    zeros: dict[str, int] = field(default_factory=dict)

    def holds(self, t_ns: int) -> bool:
        return (self.start_ns is None or t_ns >= self.start_ns) and (self.end_ns is None or t_ns < self.end_ns)

    def held(self, t_ns: Int) -> np.ndarray:
        """(N,) which of the instants are."""
        held = np.ones(len(t_ns), dtype=np.bool_)
        if self.start_ns is not None:
            held &= t_ns >= self.start_ns
        if self.end_ns is not None:
            held &= t_ns < self.end_ns
        return held


class Waiting:
    """The messages of a channel that are not decoded yet."""

    def __init__(self, channel: Channel, ways: Ways) -> None:
        self.channel, self._ways = channel, ways
        self._decoder: ColumnDecoder | None = None
        self._tries = 0
        self._begin()

    def take(self, order: int, raw: RawMessage) -> bool:
        """Whether the message may wait. Its payload is copied, so that no chunk is kept for it."""
        size = len(raw.payload)
        if size > LARGEST_BYTES:
            return False
        self._orders.append(order)
        self._log_times_ns.append(raw.log_time_ns)
        self._payloads.append(bytes(raw.payload))
        self._bytes += size
        return True

    def __len__(self) -> int:
        return len(self._payloads)

    @property
    def is_full(self) -> bool:
        return len(self._payloads) >= MOST_WAITING or self._bytes >= MOST_WAITING_BYTES

    def drain(self) -> tuple[Int, Int, list[bytes]]:
        """Orders, log times and payloads of all that wait; then none do."""
        orders, log_times_ns, payloads = self._orders, self._log_times_ns, self._payloads
        self._begin()
        return np.array(orders, np.int64), np.array(log_times_ns, np.int64), payloads

    def decoder(self, payload: bytes, definitions: Definitions) -> ColumnDecoder | None:
        """What decodes them; None where none is found by the payload."""
        if self._decoder is None and self._tries < MOST_TRIES:
            self._tries += 1
            self._decoder = definitions.column_decoder(self.channel, payload, self._ways)
        return self._decoder

    def _begin(self) -> None:
        self._orders, self._log_times_ns = array("q"), array("q")
        self._payloads: list[bytes] = []
        self._bytes = 0


def timed_columns(
    clock: Clock,
    topic: str,
    columns: Sequence[Columns],
    order: Int,
    log_time_ns: Int,
    reading: Pass,
) -> Iterator[Many]:
    """Columns with their times, those of transforms each with its own; stray stamps are left out. Raises ClocksDiffer.

    A message is within when its first time is.
    """
    times = [clock.times_ns(topic, each, log_time_ns, reading.zeros) for each in columns]
    if not times:
        return
    first_ns, first_kept = times[-1]
    for t_ns, kept in reversed(times[:-1]):
        first_ns, first_kept = np.where(kept, t_ns, first_ns), first_kept | kept
    held = reading.held(first_ns)
    for each, (t_ns, kept) in zip(columns, times, strict=True):
        if each.stamp_ns is not None and clock.stamp != "log" and not each.stamp_ns.all():
            t_ns = np.where(each.stamp_ns == 0, first_ns, t_ns)
        rows = kept & held
        if rows.all():
            yield Many(order, t_ns, topic, each)
        elif rows.any():
            yield Many(order[rows], t_ns[rows], topic, each._replace(stamp_ns=None, values=each.values[rows]))
