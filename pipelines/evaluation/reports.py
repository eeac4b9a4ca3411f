"""`quadlog report`: pictures and pages of saved runs, drawn again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from quadlog.errors import ExitCode, UsageError
from quadlog.metrics.differences import PairedDifference, paired_differences
from quadlog.pipelines.batch.summary import rebuild_summary
from quadlog.pipelines.evaluation.samples import read_samples
from quadlog.results.diff import diff_runs, first_moments
from quadlog.results.figures import drawings_of, write_plots
from quadlog.results.find_runs import files_beside_runs, is_run, refuse_existing, run_labels
from quadlog.results.page.blocks import write_page
from quadlog.results.page.run_page import write_run_page
from quadlog.results.page.runs_page import MOST_DRAWN, write_sweep_page
from quadlog.results.page.side_by_side import side_by_side_page
from quadlog.results.record import is_finished
from quadlog.results.run import Run
from quadlog.results.studies.sweep import TABLE, read_sweep_table
from quadlog.storage.atomic_write import new_folder


def rebuild_reports(runs: Sequence[Path]) -> Iterator[Path]:
    """The page of each run folder or folder of runs, once it is written; `files_beside_runs` are left out.

    Raises NotARun, CannotWrite.
    """
    beside = files_beside_runs(runs)
    for path in (path for path in runs if path not in beside):
        if not is_run(path) and path.is_dir():
            yield write_sweep(path) if (path / TABLE).is_file() else rebuild_summary(path)
            continue
        run = Run(path)
        drawings = drawings_of(run)
        write_plots(path, drawings)
        yield write_run_page(run, drawings)


def write_side_by_side(runs: Sequence[Path], output: Path, force: bool) -> Path:
    """Write a page with finished runs, the first one being what the others are compared with; returns its path.

    force: replace an existing file. Raises AlreadyExists, CannotWrite, UsageError for a run that is given twice and for
    an output that is a file of one of the runs, and what reading the runs raises: NotARun, TooLarge, UnreadableFile.
    """
    if len({path.resolve() for path in runs}) < max(len(runs), 2):
        raise UsageError("--side-by-side takes two runs or more, and none twice")
    refuse_existing(output, force, runs)
    named = dict(zip(run_labels(runs), map(Run, runs), strict=True))
    paired, notes = pair_runs(named)
    first = next(iter(named.values()))
    differences = [moment for name in paired for moment in first_moments(diff_runs(first, named[name]), first)]
    with new_folder(output.parent):
        return write_page(output, side_by_side_page(named, paired, differences, notes))


def pair_runs(runs: Mapping[str, Run]) -> tuple[dict[str, Mapping[str, PairedDifference]], list[str]]:
    """Metrics of each run less those of the first, by name, and why runs are not paired."""
    (first_name, first), *others = runs.items()
    paired: dict[str, Mapping[str, PairedDifference]] = {}
    notes = list[str]()
    own, errors = read_samples(first.path, first.metrics.keys())
    for name, run in others:
        if (why := why_not_paired(first, run)) is not None:
            notes.append(f"{name} is not paired with {first_name}: {why}")
            continue
        run.start_ns = first.start_ns
        samples, more = read_samples(run.path, run.metrics.keys() & own.keys())
        errors += more
        paired[name] = paired_differences(own, samples)
    return paired, notes + [str(error) for error in errors]


def write_sweep(folder: Path) -> Path:
    """The page of a sweep; with one seed each run is paired with that of the first value.

    Raises NotARun, CannotWrite.
    """
    rows = read_sweep_table(folder)
    names = [row.run for row in rows if row.exit_code != ExitCode.FAILED and is_finished(folder / row.run)]
    single = len({row.seed for row in rows}) == 1 and names[:1] == [rows[0].run]
    paired = pair_runs({name: Run(folder / name) for name in names[:MOST_DRAWN]})[0] if single else {}
    return write_sweep_page(folder, paired)


def why_not_paired(a: Run, b: Run) -> str | None:
    """Why instants of two runs are not the same instants; None where they are."""
    if a.simulated != b.simulated:
        return "one is a simulated walk, the other the replay of a recording"
    if a.record.input.identity != b.record.input.identity:
        return f"they are of different {'courses' if a.simulated else 'recordings'}"
    stamps = [str(run.record.options.get("stamp")).replace("auto", "header") for run in (a, b)]
    return None if a.simulated or stamps[0] == stamps[1] else f"their times are {stamps[0]} and {stamps[1]} stamps"
