"""gtec_msgs/Ranging: one range in whole millimetres, without a header."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import UwbRanges
from quadlog.recordings.decoders.stamps import stamp_ns


def decode_ranging(message: Any, topic: str) -> UwbRanges:
    """One range, from millimetres to metres; the radio reports failures as zero or less."""
    del topic
    present = int(message.range) > 0
    return UwbRanges(
        stamp_ns(message),
        int(message.tagId),
        np.array([message.anchorId] if present else [], np.int64),
        np.array([message.range / 1000] if present else [], np.float64),
    )
