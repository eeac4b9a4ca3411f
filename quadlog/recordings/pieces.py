"""What MCAP and ROS 1 bags have in common: a file of chunks, each read, checked and decompressed at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from quadlog.messages import Int
from quadlog.recordings.bounded import Damaged
from quadlog.recordings.container import Channel, Loss


@dataclass(frozen=True, slots=True)
class Piece:
    """A stretch of the file that is read at once: a chunk, or a run of records outside chunks (loose).

    length is 0 where only the chunk itself tells. channel_ids and counts
    (messages for each channel id) are None where the index does not say.
    index_end: offset behind the message index, which follows the chunk; 0 where there is none.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    compression: str = ""
    channel_ids: frozenset[int] | None = None
    counts: Mapping[int, int] | None = None
    loose: bool = False
    index_end: int = 0

    @property
    def is_empty(self) -> bool:
        """Nothing in it, as far as the index says."""
        return self.counts is not None and not any(self.counts.values())

    def may_hold(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> bool:
        """Whether any message of the wanted channels with start_ns <= log time < end_ns can be in it."""
        if self.is_empty or (self.channel_ids is not None and self.channel_ids.isdisjoint(wanted)):
            return False
        return (start_ns is None or self.end_ns >= start_ns) and (end_ns is None or self.start_ns < end_ns)


def start_of(piece: Piece) -> int:
    """The order in which pieces are read."""
    return piece.start_ns


class Entry(NamedTuple):
    """Where one message's payload lies in its piece's decompressed body."""

    log_time_ns: int
    begin: int
    end: int
    channel_id: int


class Listed(NamedTuple):
    """A piece's messages by its message index: N log times and offsets, channel after channel.

    runs: channel id, and how many of the rows are its.
    """

    runs: list[tuple[int, int]]
    t_ns: Int
    offsets: Int


class PieceFormat(Protocol):
    """What differs between the formats."""

    def load(self, piece: Piece) -> memoryview:
        """The piece's body, checked and decompressed. Raises Damaged."""
        ...

    def entries(self, body: memoryview) -> list[Entry]:
        """All messages of a body in file order. Raises Damaged."""
        ...

    def listed(self, pieces: Sequence[Piece]) -> list[Listed]:
        """All messages of each by its message index, bodies unread except those of loose pieces. Raises Damaged."""
        ...

    def counts(self, piece: Piece) -> Mapping[int, int] | None:
        """Messages for each channel id, had without reading the body; None where nothing says."""
        ...


def list_entries(entries: list[Entry]) -> Listed:
    """The same of entries that were found without an index."""
    rows = np.array([(each.channel_id, each.log_time_ns, each.begin) for each in entries], np.int64).reshape(-1, 3)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    ids, counts = np.unique(rows[:, 0], return_counts=True)
    return Listed(list(zip(ids.tolist(), counts.tolist(), strict=True)), rows[:, 1], rows[:, 2])


@dataclass
class Contents:
    """What opening a file found: where the messages are, whose they are, and what is already known to be lost.

    declared holds, for each channel id, how many messages the file itself says it has.
    """

    pieces: list[Piece]
    channel_of: dict[int, Channel]
    declared: Mapping[int, int] | None
    span_ns: tuple[int, int] | None
    losses: list[Loss] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class LostPiece:
    """A piece that could not be read, why, and how many messages it held (None: nothing says)."""

    piece: Piece
    damage: Damaged
    messages: int | None
