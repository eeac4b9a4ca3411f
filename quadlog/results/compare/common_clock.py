"""The clock on which two runs are shown together, and what cannot be compared between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from quadlog.results.plots.run_data import RunData
from quadlog.results.run.stages import STAGES
from quadlog.results.run.tables import TIMED

LETTERS = ("A", "B")


@dataclass(frozen=True, slots=True)
class CommonClock:
    """What an instant on the page is of both runs.

    is_shared: the same time stamp is the same instant in both, so that samples can be paired. why_not: the reason
    where it is not. words: what 0 s is.
    """

    is_shared: bool
    words: str
    why_not: str = ""


def open_runs(paths: tuple[Path, Path]) -> tuple[RunData, RunData, CommonClock]:
    """Both runs with their seconds on the common clock. Raises NotARun."""
    a, b = (RunData(path) for path in paths)
    clock = _clock_of(a, b)
    if clock.is_shared:
        # A run without any instant starts at 0, which is no time of the recording.
        timed = [run for run in (a, b) if any(run.table(name) is not None for name in TIMED)]
        start_ns = min((run.start_ns for run in timed), default=0)
        a.start_ns = b.start_ns = start_ns
    return a, b, clock


def _clock_of(a: RunData, b: RunData) -> CommonClock:
    apart = "the start of each run"
    if a.simulated != b.simulated:
        simulated, replay = LETTERS if a.simulated else LETTERS[::-1]
        return CommonClock(False, apart, f"{simulated} is a simulated walk and {replay} the replay of a recording")
    if a.record.input.identity != b.record.input.identity:
        what = "courses" if a.simulated else "recordings"
        return CommonClock(False, apart, f"A and B are of different {what}")
    if a.simulated:
        return CommonClock(True, "the start of the simulation, the same in both")
    stamps = [str(run.record.options.get("stamp")) for run in (a, b)]
    if stamps[0] != stamps[1]:
        return CommonClock(False, apart, f"their stamps are of different clocks: {stamps[0]} in A, {stamps[1]} in B")
    return CommonClock(True, "the start of the earlier run, on the clock of the recording")


def not_comparable(a: RunData, b: RunData, clock: CommonClock) -> Iterator[str]:
    """Sentences on what the page cannot compare, and why."""
    if not clock.is_shared:
        yield (
            f"{clock.why_not[0].upper()}{clock.why_not[1:]}: no instants are common to both, so differences have no "
            "interval, and there is no first difference. Places compare only if both maps have the same frame."
        )
    done = [{stage.name for stage in run.record.stages} for run in (a, b)]
    for letter, stages in zip(LETTERS, (done[0] - done[1], done[1] - done[0]), strict=True):
        if only := [stage for stage in STAGES if stage in stages and stage not in ("ingest", "report")]:
            yield f"Only in {letter}: the stage{'s' * (len(only) > 1)} {', '.join(only)}."
    sizes = [run.body_m() for run in (a, b)]
    if None not in sizes and sizes[0] != sizes[1]:
        yield "The robots have different sizes; the player draws both with that of A."
    for letter, run in zip(LETTERS, (a, b), strict=True):
        if left_out := run.left_out():
            rows = ", ".join(f"{many} rows of {name}.parquet" for name, many in left_out.items())
            yield f"Not drawn of {letter}, because a number in it is beyond 1e12: {rows}."
