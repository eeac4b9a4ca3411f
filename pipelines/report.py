"""`quadlog report`: draw figures and pages of runs again, in two processes where there are two cores.

This module imports nothing heavy, so that both processes load it at the same time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.pipelines.executor.local_pool import LocalPool
from quadlog.pipelines.executor.machine import cores

if TYPE_CHECKING:
    from quadlog.results.page.side_by_side import RunPair

_LOADED = ("quadlog.results.page.report", "matplotlib.backends.backend_agg", "matplotlib.figure", "matplotlib.style")


def rebuild_reports(runs: Sequence[Path]) -> Iterator[Path]:
    """The report of each run folder or folder of runs, once it is written; `files_beside_runs` are left out.

    Raises as write_report does.
    """
    with ExitStack() as stack:
        helper = stack.enter_context(LocalPool(1)) if cores() > 1 else None
        if helper is not None:
            helper.submit(load_drawing)
        load_drawing()
        from quadlog.pipelines.batch.summary import rebuild_summary
        from quadlog.results.page.report import write_report
        from quadlog.results.run.find_runs import files_beside_runs, is_run
        from quadlog.results.sweep.page import write_sweep_page
        from quadlog.results.sweep.table import TABLE

        beside = files_beside_runs(runs)
        for run in (run for run in runs if run not in beside):
            alone = is_run(run) or not run.is_dir()
            if alone:
                yield write_report(run, helper)
            else:
                yield write_sweep_page(run) if (run / TABLE).is_file() else rebuild_summary(run)


def write_side_by_side(a: Path, b: Path, output: Path, force: bool) -> Path:
    """Write a page with two finished runs, and return its path. force: replace an existing one.

    Raises AlreadyExists, UsageError for an output that is a file of a run, CannotWrite, and what reading the runs
    raises: NotARun, TooLarge, UnreadableFile.
    """
    from quadlog.results.page.side_by_side import side_by_side_page
    from quadlog.results.run.outputs import refuse_existing
    from quadlog.storage.atomic_write import new_folder, write_whole

    refuse_existing(output, force)
    page = side_by_side_page(_compare(a, b))
    with new_folder(output.parent):
        write_whole(output, page)
    return output


def _compare(a: Path, b: Path) -> RunPair:
    """Both runs, and what differs between them."""
    from quadlog.metrics.comparison.paired import paired_differences
    from quadlog.pipelines.evaluation.samples import read_samples
    from quadlog.results.compare.common_clock import open_runs
    from quadlog.results.compare.differences import EXACT
    from quadlog.results.compare.run_diff import compare_origins, diff_runs
    from quadlog.results.page.side_by_side import RunPair
    from quadlog.results.run.find_runs import run_labels

    run_a, run_b, clock = open_runs((a, b))
    diff, samples, problems = None, [], []
    if clock.is_shared:
        diff = diff_runs(a, b, EXACT)
        for run in (a, b):
            found, errors = read_samples(run, run_a.metrics.keys() & run_b.metrics.keys(), may_lack=True)
            samples.append(found)
            problems += [str(error) for error in errors]
    origins = compare_origins(run_a.record.to_dict(), run_b.record.to_dict()) if diff is None else diff.origins
    differences = paired_differences(*samples) if samples else {}
    name_a, name_b = run_labels((a, b))
    return RunPair(run_a, run_b, (name_a, name_b), clock, origins, diff, differences, problems)


def load_drawing() -> None:
    """Import all that drawing takes: a third of a short report's time."""
    for name in _LOADED:
        import_module(name)
