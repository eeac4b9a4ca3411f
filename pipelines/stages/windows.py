"""The scans of a window of a recording, classified: what every process that shares in a long recording does."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from quadlog.lidar.classify import ClassifiedScan
from quadlog.messages import Float, PointCloud
from quadlog.pipelines.opening import open_configured
from quadlog.pipelines.stages.scans import Scanner, ScanTally, Surroundings
from quadlog.recordings.clock import Clock, Stamp
from quadlog.recordings.recording import Recording


@dataclass(frozen=True, slots=True)
class Scan:
    """A classified scan at its instant, with the robot's pose (3,) x, y, yaw in map, or None where none is near.

    ms: what classifying it took.
    """

    t_ns: int
    points: ClassifiedScan
    pose_base_in_map: Float | None
    ms: float


class Window(NamedTuple):
    """Messages with start_ns <= log time < end_ns; None where it is open. By log time each is in one window only."""

    start_ns: int | None
    end_ns: int | None


def cut(whole: Window, span_ns: tuple[int, int], count: int) -> list[Window]:
    """The whole in so many windows (or fewer, of at least a nanosecond), alike in log time over the span first..last.

    Together they are the whole: what lies outside the span is in the first one or the last one.
    """
    first_ns = span_ns[0] if whole.start_ns is None else max(span_ns[0], whole.start_ns)
    end_ns = span_ns[1] + 1 if whole.end_ns is None else min(span_ns[1] + 1, whole.end_ns)
    long_ns = max(end_ns - first_ns, 0)
    borders = sorted({first_ns + long_ns * index // count for index in range(1, count)} - {first_ns, end_ns})
    return [Window(*each) for each in pairwise([whole.start_ns, *borders, whole.end_ns])]


@dataclass(frozen=True, slots=True)
class Source:
    """How to open a recording as this replay does, and what is wanted of it: the clouds of a topic.

    start_ns, end_ns: of the replay, on the chosen clock, None where it is open.
    """

    path: Path
    stamp: Stamp
    msg_path: tuple[Path, ...]
    topic: str
    start_ns: int | None
    end_ns: int | None
    around: Surroundings

    def open(self) -> Recording:
        """The recording once more. Raises as open_recording does."""
        return open_configured(self.path, self.around.config, self.msg_path, self.stamp)


@dataclass(frozen=True, slots=True)
class Seen:
    """What there is to know of a window beside its scans.

    n_clouds: those within its log times. clock: what the reader has met so far; sound: nothing else that a user must
    know of.
    """

    tally: ScanTally
    n_clouds: int
    clock: Clock
    sound: bool


class WindowReader:
    """Classifies the scans of windows of a source's recording, one window after the other."""

    def __init__(self, source: Source, recording: Recording) -> None:
        self._source, self._recording = source, recording
        self._scanner = Scanner(source.around)
        self._n_clouds = 0

    def rehearse(self) -> None:
        """Classify some cloud, so that all is loaded that the first window needs."""
        for cloud in self._recording.sample(self._source.topic, 1):
            if isinstance(cloud, PointCloud):
                self._scanner.classify(0, cloud)

    def read(self, window: Window) -> Iterator[Scan]:
        """Every scan of the window that lies in the replay, one at a time."""
        source = self._source
        self._scanner.tally, self._n_clouds = ScanTally(), 0
        for t_ns, _, message in self._recording.logged([source.topic], *window):
            if not isinstance(message, PointCloud):
                continue
            self._n_clouds += 1
            if (source.start_ns is None or t_ns >= source.start_ns) and (source.end_ns is None or t_ns < source.end_ns):
                started = time.perf_counter()
                points, pose = self._scanner.classify(t_ns, message)
                yield Scan(t_ns, points, pose, (time.perf_counter() - started) * 1e3)

    def seen(self) -> Seen:
        """Of the window that was read last, to its end."""
        sound = not self._recording.losses and not self._recording.warnings
        return Seen(self._scanner.tally, self._n_clouds, self._recording.clock, sound)
