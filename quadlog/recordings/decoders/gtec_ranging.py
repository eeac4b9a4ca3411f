"""gtec_msgs/Ranging: one range in whole millimetres, without a header."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import UwbRanges
from quadlog.recordings.decoders.stamps import stamp_ns


def decode_ranging(message: Any, topic: str) -> UwbRanges:
    """One range, from millimetres to metres; failures, which the radio reports as zero or less, are passed on."""
    del topic
    return UwbRanges(
        stamp_ns(message),
        int(message.tagId),
        np.array([message.anchorId], np.int64),
        np.array([message.range / 1000], np.float64),
    )
