"""The story of `quadlog report`: pictures and pages of runs again, drawn in two processes where there are two cores.

Nothing heavy is loaded with this module, so that the other process loads it at the same time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.errors import WorkerDied
from quadlog.pipelines.engine.cores import cores
from quadlog.pipelines.engine.local_pool import LocalPool

if TYPE_CHECKING:
    from quadlog.results.plots.run_data import RunData

_LOADED = ("quadlog.results.report", "matplotlib.backends.backend_agg", "matplotlib.figure", "matplotlib.style")


def rebuild_reports(runs: Sequence[Path]) -> Iterator[Path]:
    """The report of each run folder or folder of runs, once it is written. Raises as write_report does."""
    with ExitStack() as stack:
        helper = stack.enter_context(LocalPool(1)) if cores() > 1 else None
        if helper is not None:
            helper.submit(load_drawing)
        load_drawing()
        from quadlog.results.plots.figures import render_plots
        from quadlog.results.report import write_folder_report, write_report
        from quadlog.results.tables import has_table

        render = render_plots if helper is None else partial(draw_in_two, helper)
        for run in runs:
            yield write_folder_report(run) if has_table(run, "summary") else write_report(run, render)


def load_drawing() -> None:
    """Import all that drawing takes: a third of a short report's time."""
    for name in _LOADED:
        import_module(name)


def draw_in_two(helper: Executor, run: RunData) -> dict[str, bytes]:
    """All figures of a run: every second one by the helper, meanwhile the others here; all, should it be killed."""
    from quadlog.results.plots.figures import PLOTS, render_plots

    # Neighbours in the report take about as long to draw as each other.
    elsewhere, here = ([plot.name for plot in PLOTS[first::2]] for first in (0, 1))
    others = helper.submit(draw_some, run.path, elsewhere)
    drawn = render_plots(run, here)
    try:
        drawn |= others.result()
    except WorkerDied:
        drawn |= render_plots(run, elsewhere)
    return {plot.name: drawn[plot.name] for plot in PLOTS if plot.name in drawn}


def draw_some(run: Path, names: Collection[str]) -> dict[str, bytes]:
    """The figures of these names of a finished run."""
    from quadlog.results.plots.figures import render_plots
    from quadlog.results.plots.run_data import RunData

    return render_plots(RunData(run), names)
