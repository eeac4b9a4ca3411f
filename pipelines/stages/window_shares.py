"""Whether a recording is worth sharing between processes, and into which windows it is cut then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from quadlog.messages import PointCloud
from quadlog.pipelines.stages.windows import Source, Window, cut
from quadlog.recordings.container import Channel
from quadlog.recordings.recording import Recording

POINT_US = {"range_image": 0.15, "paper": 0.6}
"""Reading, decompressing, decoding and classifying a point, as measured."""
WORTH_S = 5.0
"""Another process takes two or three seconds of a core to start: it is worth it for this much of the work or more."""
WINDOW_POINTS = 300_000
"""Of 17 bytes each, and a few windows are held; in much shorter ones most chunks would lie in two and be read twice."""
UNEVEN = 4
"""A window with so many times the scans that it should have is not held, but classified when its turn comes."""


@dataclass(frozen=True, slots=True)
class Shares:
    """How a recording is shared.

    most_scans: too many for a window. n_clouds: what the recording says it has, None where that is not to be compared.
    """

    windows: Sequence[Window]
    helpers: int
    most_scans: int
    n_clouds: int | None


def share(source: Source, recording: Recording, whole: Window, processes: int) -> Shares | None:
    """How so many processes share a recording, of which `whole` is replayed; None where it does not pay or cannot be.

    By what the recording itself says, never by a clock, so that one recording is always shared alike.
    """
    channel = _only_channel(recording, source.topic)
    span = recording.span_ns
    if processes < 2 or channel is None or channel.count is None or span is None:
        return None
    if recording.losses or recording.container.warnings or not recording.container.is_divisible():
        return None
    n_scans = channel.count * _part(whole, span)
    n_points = n_scans * _points_of_first(recording, source.topic)
    work_s = n_points * POINT_US[source.around.config.lidar.method] * 1e-6
    helpers = min(processes - 1, int(work_s / WORTH_S))
    if helpers == 0:
        return None
    n_windows = math.ceil(n_points / WINDOW_POINTS)
    promised = channel.count if whole == (None, None) else None
    return Shares(cut(whole, span, n_windows), helpers, math.ceil(UNEVEN * n_scans / n_windows), promised)


def _only_channel(recording: Recording, topic: str) -> Channel | None:
    channels = [channel for channel in recording.channels if channel.topic == topic]
    return channels[0] if len(channels) == 1 else None


def _part(whole: Window, span_ns: tuple[int, int]) -> float:
    """The share of the recording's log times, first to last, that a window has."""
    begin_ns = span_ns[0] if whole.start_ns is None else max(span_ns[0], whole.start_ns)
    end_ns = span_ns[1] + 1 if whole.end_ns is None else min(span_ns[1] + 1, whole.end_ns)
    return max(end_ns - begin_ns, 0) / (span_ns[1] + 1 - span_ns[0])


def _points_of_first(recording: Recording, topic: str) -> int:
    clouds = [each for each in recording.sample(topic, 1) if isinstance(each, PointCloud)]
    return len(clouds[0].xyz_m) if clouds else 0
