"""One pass over a recording: small topics become columns, clouds are classified as they come.

What must be known before the first cloud, static transforms above all, is fetched through the recording's index.
"""

from __future__ import annotations

from collections import deque

from quadlog.messages import PointCloud
from quadlog.pipelines.progress import Progress, StageClock
from quadlog.pipelines.stages.scans import Scanner, end_of_sweep_ns
from quadlog.pipelines.stages.tilt import Tilt
from quadlog.recordings.gathering import One
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import Gatherer

MOST_WAITING = 8
"""Clouds that wait at most: those logged long before their stamps are classified with the tilt known then."""


def read_small(recording: Recording, wanted: Gatherer, window: tuple[int | None, int | None]) -> None:
    """The small topics alone."""
    for gathered in recording.gathered(wanted.moving, (), *window) if wanted.moving else ():
        wanted.take(gathered, recording.stamp)


def read_all(
    recording: Recording,
    wanted: Gatherer,
    lidar: str,
    window: tuple[int | None, int | None],
    scanner: Scanner,
    tilt: Tilt,
    clock: StageClock,
    progress: Progress,
) -> int | None:
    """The small topics, and every cloud of a lidar, which waits until the body's tilt is known up to its last point.

    Returns the instant of the first cloud, None where there was none.
    """
    start_ns: int | None = None
    waiting: deque[tuple[int, PointCloud]] = deque()
    with clock.laps("ingest", "filter") as lap:
        for gathered in recording.gathered([*wanted.moving, lidar], tilt.topics(wanted.moving_tf), *window):
            if gathered.topic != lidar:
                wanted.take(gathered, recording.stamp)
                tilt.take(gathered)
                continue
            if not isinstance(gathered, One) or not isinstance(gathered.message, PointCloud):
                continue
            lap("ingest")
            t_ns = gathered.t_ns
            start_ns = t_ns if start_ns is None else start_ns
            waiting.append((t_ns, gathered.message))
            while len(waiting) > MOST_WAITING or (waiting and tilt.reaches(end_of_sweep_ns(*waiting[0]))):
                scanner.take(*waiting.popleft())
            progress.advance((t_ns - start_ns) * 1e-9)
            lap("filter")
        for each in waiting:
            scanner.take(*each)
        lap("filter")
    return start_ns
