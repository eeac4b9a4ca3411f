"""`quadlog check`: compare runs with a file of bounds, or make such a file from runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from quadlog.config.file import read_bounds
from quadlog.errors import CannotWrite, QuadlogError, UsageError
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.check import (
    RunCheck,
    accepted,
    bound_names,
    bounds_toml,
    check_run,
    junit_xml,
    propose,
)
from quadlog.results.find_runs import failed_recordings, find_runs, refuse_existing, run_labels
from quadlog.results.record import read_metrics
from quadlog.results.run import Run
from quadlog.storage.atomic_write import write_whole


def check_runs(
    paths: Sequence[Path], expect: Path, junit: Path | None, force: bool, say: Callable[[str], None]
) -> list[RunCheck]:
    """Check every run; junit: where to write the JUnit XML, None for nowhere.

    A run that cannot be read has an error, and so has a recording that could not be replayed. Raises NotARun for a path
    without runs, AlreadyExists, CannotWrite, UsageError, and what reading the file of bounds raises.
    """
    if junit is not None and junit.resolve() == expect.resolve():
        raise UsageError(f"--junit {junit} would replace the bounds of --expect")
    if junit is not None:
        refuse_existing(junit, force)
    bounds, checks, given = read_bounds(expect), list[RunCheck](), set[str]()
    for path in find_runs(paths):
        try:
            run = Run(path)
            read_metrics(path)  # where they are missing or damaged, the check fails, whatever the bounds
            checks.append(check_run(run, bounds))
            given |= set(bound_names(run))
        except QuadlogError as error:
            checks.append(RunCheck(str(path), path.resolve().name, error=str(error)))
    checks += [RunCheck(str(run), run.name, error=why) for run, why in failed_recordings(paths).items()]
    # Recordings with bounds but without a run would otherwise pass unnoticed.
    if unchecked := sorted(bounds.keys() - given - {""}):
        say(f"not checked, no such run was given: {', '.join(unchecked)}")
    if junit is not None:
        _write(junit, junit_xml(checks, run_labels(Path(check.run) for check in checks)))
    return checks


def propose_bounds(paths: Sequence[Path], expect: Path, force: bool, say: Callable[[str], None]) -> dict[str, int]:
    """Write bounds made from the runs into a new file; returns how many for each name.

    Bounds that accept a contact or a fall are commented there and listed; metrics that the catalogue lacks
    are listed, not bounded. Raises NotARun, AlreadyExists for an existing file unless `force`, CannotWrite.
    """
    refuse_existing(expect, force)
    runs = [Run(path) for path in find_runs(paths)]
    bounds = propose(runs)
    _write(expect, bounds_toml(bounds))
    for name, mine in bounds.items():
        if events := [words for metric, bound in mine.items() if (words := accepted(metric, bound))]:
            say(f"warning: the bounds for {name} accept {'; '.join(events)}")
    if unknown := sorted({name for run in runs for name in run.metrics} - CATALOGUE.keys()):
        say(f"not bounded, no metrics of quadlog's catalogue: {', '.join(unknown)}")
    return {name: len(mine) for name, mine in bounds.items()}


def _write(path: Path, content: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
    write_whole(path, content)
