"""`quadlog report`: draw figures and pages of runs again, in two processes where there are two cores.

This module imports nothing heavy, so that both processes load it at the same time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path

from quadlog.pipelines.executor.local_pool import LocalPool
from quadlog.pipelines.executor.machine import cores

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


def load_drawing() -> None:
    """Import all that drawing takes: a third of a short report's time."""
    for name in _LOADED:
        import_module(name)
