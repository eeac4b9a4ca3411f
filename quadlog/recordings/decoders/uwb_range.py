"""uwb_driver/UwbRange: one two-way range; the requester is the tag, the responder the anchor."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import UwbRanges
from quadlog.recordings.decoders.stamps import stamp_ns


def decode_uwb_range(message: Any, topic: str) -> UwbRanges:
    """One range in metres, a distance or not. Older versions of the message have no requester: tag None then."""
    del topic
    requester = getattr(message, "requester_id", None)
    return UwbRanges(
        stamp_ns(message),
        None if requester is None else int(requester),
        np.array([message.responder_id], np.int64),
        np.array([message.distance], np.float64),
    )
