"""`quadlog report`: pictures and pages of saved runs, drawn again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from quadlog.errors import UsageError
from quadlog.metrics.differences import paired_differences
from quadlog.pipelines.batch.summary import rebuild_summary
from quadlog.pipelines.evaluation.samples import read_samples
from quadlog.results.diff import diff_runs, first_moments
from quadlog.results.figures import drawings_of, write_plots
from quadlog.results.find_runs import files_beside_runs, is_run, refuse_existing, run_labels
from quadlog.results.page.blocks import write_page
from quadlog.results.page.run_page import write_run_page
from quadlog.results.page.runs_page import Compared, side_by_side_page, write_sweep_page
from quadlog.results.run import Run
from quadlog.results.studies.sweep import TABLE
from quadlog.storage.atomic_write import new_folder


def rebuild_reports(runs: Sequence[Path]) -> Iterator[Path]:
    """The page of each run folder or folder of runs, once it is written; `files_beside_runs` are left out.

    Raises NotARun, CannotWrite.
    """
    beside = files_beside_runs(runs)
    for path in (path for path in runs if path not in beside):
        if not is_run(path) and path.is_dir():
            yield write_sweep_page(path) if (path / TABLE).is_file() else rebuild_summary(path)
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
    compared, notes = _compare(runs)
    page = side_by_side_page(" and ".join(dict.fromkeys(run.title for run in compared.runs.values())), compared, notes)
    with new_folder(output.parent):
        return write_page(output, page)


def _compare(paths: Sequence[Path]) -> tuple[Compared, list[str]]:
    """The runs by name, what differs between the first and each other one, and why runs cannot be paired."""
    runs = dict(zip(run_labels(paths), map(Run, paths), strict=True))
    (first_name, first), *others = runs.items()
    paired, moments, notes = {}, [], []
    own, errors = read_samples(first.path, first.metrics.keys())
    for name, run in others:
        if (why := why_not_paired(first, run)) is not None:
            notes.append(f"{name} is not paired with {first_name}: {why}")
            continue
        run.start_ns = first.start_ns
        samples, more = read_samples(run.path, run.metrics.keys() & own.keys())
        errors += more
        paired[name] = paired_differences(own, samples)
        moments += first_moments(diff_runs(first, run), first)
    notes += [str(error) for error in errors]
    return Compared(runs, not notes and len(paired) == len(others), paired, moments), notes


def why_not_paired(a: Run, b: Run) -> str | None:
    """Why instants of two runs are not the same instants; None where they are."""
    if a.simulated != b.simulated:
        return "one is a simulated walk, the other the replay of a recording"
    if a.record.input.identity != b.record.input.identity:
        return f"they are of different {'courses' if a.simulated else 'recordings'}"
    stamps = [str(run.record.options.get("stamp")).replace("auto", "header") for run in (a, b)]
    return None if a.simulated or stamps[0] == stamps[1] else f"their times are {stamps[0]} and {stamps[1]} stamps"
