"""`quadlog check`: compare runs with a file of bounds, or make such a file from runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from quadlog.errors import CannotWrite, QuadlogError, UsageError
from quadlog.results.compare.check_text import junit_xml
from quadlog.results.compare.expectations import Expectations, read_expectations, read_text
from quadlog.results.compare.run_check import (
    HEADER,
    RunCheck,
    accepted_events,
    bound_names,
    check_run,
    merge_bounds,
    propose,
)
from quadlog.results.run.find_runs import failed_recordings, find_runs, run_labels
from quadlog.results.run.loaded_run import Run, load_run
from quadlog.results.run.outputs import refuse_existing
from quadlog.results.run.tables import METRIC_NAMES
from quadlog.storage.atomic_write import write_whole


def check_runs(
    paths: Sequence[Path], expect: Path, junit: Path | None, force: bool, say: Callable[[str], None]
) -> list[RunCheck]:
    """Check every run; junit: where to write the JUnit XML, None for nowhere.

    A run that cannot be read has an error, and so has a recording that could not be replayed. Raises NotARun for a path
    without runs, AlreadyExists, CannotWrite, UsageError, and what reading the file of bounds raises.
    """
    if junit is not None:
        if junit.resolve() == expect.resolve():
            raise UsageError(f"--junit {junit} would replace the bounds of --expect")
        refuse_existing(junit, force)
    runs = [_load_or_explain(run) for run in find_runs(paths)]
    runs += [RunCheck(str(run), run.name, error=why) for run, why in failed_recordings(paths).items()]
    readable = [run for run in runs if isinstance(run, Run)]
    expectations = read_expectations(expect, _known_metrics(readable))
    checks = [check_run(run, expectations) if isinstance(run, Run) else run for run in runs]
    _say_what_was_not_checked(expectations, readable, say)
    if junit is not None:
        _write(junit, junit_xml(checks, run_labels(Path(check.run) for check in checks)))
    return checks


def propose_bounds(paths: Sequence[Path], expect: Path, force: bool, say: Callable[[str], None]) -> dict[str, int]:
    """Write bounds made from the runs into the file; returns how many for each name.

    Bounds that accept a contact or a fall have a comment in the file, and are said.

    An existing file needs `force`: it keeps its comments and all bounds but
    those proposed. Raises NotARun, AlreadyExists, CannotWrite, and for an
    existing file what reading it raises.
    """
    refuse_existing(expect, force)
    runs = [load_run(run) for run in find_runs(paths)]
    text = HEADER
    if expect.exists():
        read_expectations(expect, _known_metrics(runs))
        text = read_text(expect)
    bounds = propose(runs)
    _write(expect, merge_bounds(text, bounds, expect).encode())
    for name, accepted in accepted_events(bounds).items():
        say(f"warning: the bounds for {name} accept {'; '.join(accepted)}")
    return {name: len(each) for name, each in bounds.items()}


def _load_or_explain(path: Path) -> Run | RunCheck:
    """The run with its metrics, or a failed check if it cannot be read."""
    try:
        run = load_run(path)
        _ = run.metrics  # read here, where damage is a failed check
    except QuadlogError as error:
        return RunCheck(str(path), path.resolve().name, error=str(error))
    return run


def _write(path: Path, content: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
    write_whole(path, content)


def _known_metrics(runs: Sequence[Run]) -> Collection[str]:
    """The contract's, and what else the runs have."""
    return {*METRIC_NAMES, *(name for run in runs for name in run.metrics)}


def _say_what_was_not_checked(expectations: Expectations, runs: Sequence[Run], say: Callable[[str], None]) -> None:
    """Name the recordings with bounds but without a run, which would otherwise pass unnoticed."""
    given = {name for run in runs for name in bound_names(run)}
    if unchecked := sorted(set(expectations.recordings) - given):
        say(f"not checked, no such run was given: {', '.join(unchecked)}")
