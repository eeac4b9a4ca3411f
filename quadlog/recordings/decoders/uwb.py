"""UWB ranges of every driver's messages, and whose ends a topic's ranges have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.messages import UNITS_M, Float, UwbRanges
from quadlog.recordings.decoders.columns import ABSENT, WHOLE, Columns, header_of, stamps_ns
from quadlog.recordings.decoders.payload import stamp_ns
from quadlog.recordings.decoders.range_ends import Ends, ends_of_topic


def decode_ranging(message: Any, _: str) -> UwbRanges:
    """One range, from millimetres to metres; failures, which the radio reports as zero or less, are passed on."""
    return _single(message, int(message.tagId), message.anchorId, message.range / 1000)


__all__ = ["Ends", "ends_of_topic"]  # until callers take them from there
ROLE_ANCHOR, ROLE_TAG = 1, 2
STAMPED_TAGFRAME0 = header_of("header") | {"id": WHOLE, "dis_arr": 8}
TAGFRAME0 = {"header.stamp.sec": ABSENT, "id": WHOLE, "dis_arr": 8}


def decode_tagframe0(message: Any, _: str) -> tuple[UwbRanges, ...]:
    """A tag's own distances to anchors 0 to 7."""
    return (_from_distances(stamp_ns(message), int(message.id), message.dis_arr),)


def tagframe0_in_columns(_: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers (N, 9) of TAGFRAME0, or (N, 11) of STAMPED_TAGFRAME0."""
    stamp_ns = stamps_ns(numbers[:, :2]) if numbers.shape[1] > 9 else None
    return [Columns(UwbRanges, stamp_ns, numbers[:, -9:])], np.ones(len(numbers), dtype=bool)


def decode_anchorframe0(message: Any, _: str) -> tuple[UwbRanges, ...]:
    """What an anchor gathered: the distances of each tag to anchors 0 to 7."""
    stamp = stamp_ns(message)
    return tuple(_from_distances(stamp, int(tag.id), tag.dis_arr) for tag in message.nodes)


def decode_nodeframe4(message: Any, _: str) -> tuple[UwbRanges, ...]:
    """What a console gathered: for each tag, the anchors it heard."""
    stamp = stamp_ns(message)
    return tuple(
        _ranges(stamp, int(tag.id), [(int(each.id), float(each.dis), None) for each in tag.anchors])
        for tag in message.tags
    )


def decode_nodeframe(message: Any, _: str) -> tuple[UwbRanges, ...]:
    """Nodeframes 2, 3 and 5: one node's distances to the others, with signal strengths.

    A tag's frame lists its anchors. An anchor's frame lists tags, each of which
    makes one entry. Plain nodes have no roles: the sender counts as the tag.
    """
    stamp, sender = stamp_ns(message), int(message.id)
    if int(message.role) == ROLE_ANCHOR:
        tags = [node for node in message.nodes if int(node.role) != ROLE_ANCHOR]
        return tuple(_ranges(stamp, int(tag.id), [(sender, float(tag.dis), _gap_db(tag))]) for tag in tags)
    anchors = [node for node in message.nodes if int(node.role) != ROLE_TAG]
    return (_ranges(stamp, sender, [(int(node.id), float(node.dis), _gap_db(node)) for node in anchors]),)


def _gap_db(node: Any) -> float:
    return float(node.rx_rssi) - float(node.fp_rssi)


def _from_distances(stamp: int | None, tag: int, distances: Iterable[float]) -> UwbRanges:
    return _ranges(stamp, tag, [(anchor, float(distance), None) for anchor, distance in enumerate(distances)])


def _ranges(stamp: int | None, tag: int, measured: list[tuple[int, float, float | None]]) -> UwbRanges:
    present = [each for each in measured if each[1] != 0]
    gaps = [gap for _, _, gap in present if gap is not None]
    return UwbRanges(
        stamp,
        tag,
        np.array([anchor for anchor, _, _ in present], np.int64),
        np.array([distance for _, distance, _ in present], np.float64),
        np.array(gaps, np.float64) if gaps else None,
    )


UNKNOWN_ANCHOR = -1


def decode_range(message: Any, _: str) -> UwbRanges:
    """One range with tag None and anchor -1; what else is no distance, as NaN or zero, is passed on to be counted.

    Infinite ranges [REP 117], and those beyond min_range or max_range where the latter is larger (drivers may leave
    both at zero), were not measured.
    """
    range_m, low_m, high_m = float(message.range), float(message.min_range), float(message.max_range)
    unmeasured = ""
    if np.isinf(range_m):
        unmeasured = "they are infinite: too near or too far [REP 117]"
    elif 0 <= low_m < high_m and (range_m < low_m or range_m > high_m):
        unmeasured = "they are outside min_range to max_range of their own messages"
    return _single(message, None, UNKNOWN_ANCHOR, range_m, unmeasured)


def _single(message: Any, tag: int | None, anchor: int, range_m: float, unmeasured: str = "") -> UwbRanges:
    measured = slice(0 if unmeasured else 1)
    ids, ranges_m = np.array([anchor], np.int64), np.array([range_m], np.float64)
    return UwbRanges(stamp_ns(message), tag, ids[measured], ranges_m[measured], unmeasured=unmeasured)


NO_ANSWER, NO_EDGE = (1, 3), 0b100110
"""Values of range_status of failed rangings, and bits of the even ones; other values are remarks on a range."""


def decode_uwb_range(message: Any, _: str) -> UwbRanges:
    """One range in metres, a distance or not, with the anchor's position where the message has that field.

    Older versions of the message have no requester: tag None then. A ranging whose range_status says that it failed
    measured nothing.
    """
    requester, place = getattr(message, "requester_id", None), getattr(message, "responder_location", None)
    status = int(getattr(message, "range_status", 0))
    failed = status in NO_ANSWER or (status % 2 == 0 and status & NO_EDGE)
    unmeasured = "their range_status says that the ranging failed" if failed else ""
    tag = None if requester is None else int(requester)
    ranges = _single(message, tag, message.responder_id, message.distance, unmeasured)
    if place is None or failed:
        return ranges
    return replace(ranges, anchor_position_m=np.array([[place.x, place.y, place.z]], np.float64))


def in_metres(ranges: UwbRanges, unit: str, type_name: str) -> UwbRanges:
    """Ranges of a driver that sends another unit than its type has."""
    own = "mm" if type_name == "gtec_msgs/msg/Ranging" else "m"
    return replace(ranges, range_m=ranges.range_m * (UNITS_M[unit] / UNITS_M[own]))


def names_anchors(ranges: UwbRanges) -> bool:
    """Whether the ranges say which anchors they are of."""
    return len(ranges.anchor) > 0 and int(ranges.anchor[0]) >= 0


def with_ends(ranges: UwbRanges, ends: Ends | None) -> UwbRanges:
    """Ranges that name no tag as those of tag 0, or between the ends where they name no anchor either."""
    if names_anchors(ranges):
        return replace(ranges, tag=0)
    if ends is None:
        return ranges
    return replace(ranges, tag=ends.tag, anchor=np.full(len(ranges.anchor), ends.anchor, np.int64))
