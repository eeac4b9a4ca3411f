"""sensor_msgs/Range used for UWB: one range, whose two ends only the topic tells (range_topics.py)."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import UwbRanges
from quadlog.recordings.decoders.stamps import stamp_ns

UNKNOWN_ANCHOR = -1


def decode_range(message: Any, topic: str) -> UwbRanges:
    """One range with tag None and anchor -1.

    min_range and max_range are not applied: UWB drivers leave both at zero. An
    infinite range means "nothing measured" in this message and is left out;
    whatever else is no distance is passed on, so that it is counted.
    """
    del topic
    range_m = float(message.range)
    present = range_m != np.inf
    return UwbRanges(
        stamp_ns(message),
        None,
        np.array([UNKNOWN_ANCHOR] if present else [], np.int64),
        np.array([range_m] if present else [], np.float64),
    )
