"""Putting into words what a file of chunks lost, one Loss for each cause."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from quadlog.messages import Int
from quadlog.recordings.container import Loss
from quadlog.recordings.pieces import LostPiece, Piece
from quadlog.recordings.words import instant, several

JUMP_NS = 10**9
_DAY_NS = 86_400 * 10**9


def losses_of(lost: Iterable[LostPiece]) -> list[Loss]:
    """One Loss for each cause, in the order in which the first of its pieces lies in the file."""
    groups: dict[str, list[LostPiece]] = {}
    for each in sorted(lost, key=lambda each: each.piece.offset):
        groups.setdefault(each.damage.cause, []).append(each)
    return [_loss(cause, group) for cause, group in groups.items()]


def _loss(cause: str, group: list[LostPiece]) -> Loss:
    known = [each.messages for each in group if each.messages is not None]
    messages = several(sum(known), "message") if len(known) == len(group) else "an unknown number of messages"
    start_ns = min(each.piece.start_ns for each in group)
    end_ns = max(each.piece.end_ns for each in group)
    first = group[0]
    return Loss(
        cause,
        f"{several(len(group), 'chunk')} with {messages} between {instant(start_ns)} and {instant(end_ns)} lost; "
        f"{'first' if len(group) > 1 else 'it lies'} at offset {first.piece.offset}: {first.damage.reason}",
        count=sum(known) if len(known) == len(group) else None,
    )


def backward_jumps(pieces: Iterable[Piece]) -> list[int]:
    """By how many ns log time falls back, in file order, at each piece where that is more than a second."""
    jumps, latest_ns = [], 0
    for piece in sorted(pieces, key=lambda piece: piece.offset):
        if piece.is_empty or piece.end_ns == 0:
            continue
        if piece.start_ns < latest_ns - JUMP_NS:
            jumps.append(latest_ns - piece.start_ns)
        latest_ns = max(latest_ns, piece.end_ns)
    return jumps


def backward_jump_within(times_ns: Int) -> int:
    """The largest fall of log time (ns) below an earlier message's, 0 when it is at most a second."""
    largest_ns = int((np.maximum.accumulate(times_ns) - times_ns).max(initial=0))
    return largest_ns if largest_ns > JUMP_NS else 0


def jump_warning(jumps_ns: list[int]) -> list[str]:
    """No warning or one, over all jumps of the recording's clock."""
    if not jumps_ns:
        return []
    times = several(len(jumps_ns), "time")
    largest_s = max(jumps_ns) / 1e9
    return [f"log time goes back {times} in the file, by up to {largest_s:.3f} s; messages come in order of log time"]


def zero_time_warning(zero_count: int, end_ns: int) -> list[str]:
    """No warning or one: messages logged at time 0 by a clock that otherwise is nowhere near it."""
    if not zero_count or end_ns < _DAY_NS:
        return []
    return [f"{several(zero_count, 'message')} logged at time 0, the others until {instant(end_ns)}"]
