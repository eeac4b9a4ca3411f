"""Nooploop LinkTrack frames, with or without a header: the ranges of tags to anchors.

Packages spell their names differently, so decoding.py matches the last part
of the type. A distance of 0 means that there was none; whatever else is no
distance is passed on, so that it is counted.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from quadlog.messages import Float, UwbRanges
from quadlog.recordings.columns import Columns, stamps_ns
from quadlog.recordings.decoders.stamps import stamp_ns
from quadlog.recordings.payload_layout import ABSENT, WHOLE, header_of

ROLE_ANCHOR, ROLE_TAG = 1, 2
STAMPED_TAGFRAME0 = header_of("header") | {"id": WHOLE, "dis_arr": 8}
TAGFRAME0 = {"header.stamp.sec": ABSENT, "id": WHOLE, "dis_arr": 8}


def decode_tagframe0(message: Any, topic: str) -> tuple[UwbRanges, ...]:
    """A tag's own distances to anchors 0 to 7."""
    del topic
    return (_from_distances(stamp_ns(message), int(message.id), message.dis_arr),)


def tagframe0_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers (N, 9) of TAGFRAME0."""
    del texts
    return [Columns(UwbRanges, None, numbers)], np.ones(len(numbers), dtype=bool)


def stamped_tagframe0_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers (N, 11) of STAMPED_TAGFRAME0."""
    del texts
    return [Columns(UwbRanges, stamps_ns(numbers[:, :2]), numbers[:, 2:])], np.ones(len(numbers), dtype=bool)


def decode_anchorframe0(message: Any, topic: str) -> tuple[UwbRanges, ...]:
    """What an anchor gathered: the distances of each tag to anchors 0 to 7."""
    del topic
    stamp = stamp_ns(message)
    return tuple(_from_distances(stamp, int(tag.id), tag.dis_arr) for tag in message.nodes)


def decode_nodeframe4(message: Any, topic: str) -> tuple[UwbRanges, ...]:
    """What a console gathered: for each tag, the anchors it heard."""
    del topic
    stamp = stamp_ns(message)
    return tuple(
        _ranges(stamp, int(tag.id), [(int(each.id), float(each.dis), None) for each in tag.anchors])
        for tag in message.tags
    )


def decode_nodeframe(message: Any, topic: str) -> tuple[UwbRanges, ...]:
    """Nodeframes 2, 3 and 5: one node's distances to the others, with signal strengths.

    A tag's frame lists its anchors. An anchor's frame lists tags, each of which
    makes one entry. Plain nodes have no roles: the sender counts as the tag.
    """
    del topic
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
