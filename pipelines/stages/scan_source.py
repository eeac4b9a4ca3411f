"""Where `filter` has its scans from: this process alone, or several that share a long recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Protocol

from quadlog.pipelines.stages.scans import ScanTally, Surroundings
from quadlog.pipelines.stages.walk import Walk
from quadlog.pipelines.stages.window_shares import share
from quadlog.pipelines.stages.window_turns import Odd, shared_scans
from quadlog.pipelines.stages.windows import Scan, Source, Window, WindowReader

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest


AGAIN = "something about the recording is odd, of which windows cannot tell all: one process reads it once more"


class Scans(Protocol):
    """All scans of a replay, in the order they were logged; `tally` is theirs once they are read."""

    tally: ScanTally

    def read(self) -> Iterator[Scan]:
        """One at a time."""
        ...


class ScansAlone:
    """Those that this process classifies alone."""

    def __init__(self, reader: WindowReader, whole: Window) -> None:
        self.tally = ScanTally()
        self._reader, self._whole = reader, whole

    def read(self) -> Iterator[Scan]:
        """See Scans."""
        yield from self._reader.read(self._whole)
        self.tally.add(self._reader.seen().tally)


def use_scans(walk: Walk, request: ReplayRequest, use: Callable[[Walk, Scans], None]) -> None:
    """Call `use` with all scans, and once more with the same ones when sharing has to be given up.

    So what `use` writes and tells is the same for any number of processes.
    """
    walk.use("lidar")
    source = _source(walk, request)
    with walk.clock.stage("filter"):
        whole = Window(*walk.recording.log_window([source.topic], source.start_ns, source.end_ns))
        shares = share(source, walk.recording, whole, request.processes)
    if shares is not None:
        before = dict(walk.counts), walk.first_ns, walk.last_ns
        try:
            with shared_scans(source, shares, walk.recording.clock, walk.progress.say) as scans:
                use(walk, scans)
            return
        except Odd:
            walk.progress.say(AGAIN)
            walk.counts, walk.first_ns, walk.last_ns = before
    use(walk, ScansAlone(WindowReader(source, walk.recording), whole))


def _source(walk: Walk, request: ReplayRequest) -> Source:
    options = request.options
    return Source(
        path=request.recording,
        stamp=options.stamp,
        msg_path=options.msg_path,
        topic=walk.lidar_topic(),
        start_ns=walk.start_ns,
        end_ns=walk.end_ns,
        around=Surroundings.of_walk(walk),
    )
