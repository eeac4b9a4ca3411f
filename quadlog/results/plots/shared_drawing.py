"""All figures of a run: drawn from the front by a helper, if there is one, and from the back by who asks for them."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from functools import lru_cache
from pathlib import Path

from quadlog.errors import WorkerDied
from quadlog.results.plots.figures import PLOTS, render_plots
from quadlog.results.plots.run_data import RunData


class SharedDrawing:
    """Figures that the helper begins with at once, while this process does something else first."""

    def __init__(self, run: RunData, helper: Executor | None = None) -> None:
        """helper: one process, which takes tasks in their order."""
        self._run = run
        submit = None if helper is None else helper.submit
        self._asked = {} if submit is None else {plot.name: submit(_draw_one, run.path, plot.name) for plot in PLOTS}

    def finish(self) -> dict[str, bytes]:
        """Draw what the helper has not begun, the last figure first, and return all: as render_plots does.

        Raises NotARun for damaged files.
        """
        if not self._asked:
            return render_plots(self._run)
        drawn: dict[str, bytes] = {}
        for name in reversed(self._asked):
            if not self._asked[name].cancel():
                break  # the helper has come this far
            drawn |= render_plots(self._run, [name])
        for name, future in self._asked.items():
            if not future.cancelled():
                drawn |= self._drawn_by_helper(name, future)
        return {plot.name: drawn[plot.name] for plot in PLOTS if plot.name in drawn}

    def _drawn_by_helper(self, name: str, future: Future[dict[str, bytes]]) -> dict[str, bytes]:
        try:
            return future.result()
        except WorkerDied:
            return render_plots(self._run, [name])


@lru_cache(maxsize=1)
def _run_at(path: Path) -> RunData:
    """Read by the helper once for all its figures of a run."""
    return RunData(path)


def _draw_one(path: Path, name: str) -> dict[str, bytes]:
    return render_plots(_run_at(path), [name])
