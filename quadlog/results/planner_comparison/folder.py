"""The folder of a comparison: tables, a picture of the ratios for each source, and the page, which is written last.

Files: planners and replans as Parquet, scenarios.parquet with a .scen file, planners.csv, .json and .tex,
plots/source-N-ratios.png, report.html. Nothing is written, and nothing of an earlier comparison is removed, before all
sources are compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from numpy.typing import NDArray

from quadlog.errors import CannotWrite
from quadlog.metrics.planning import Comparison
from quadlog.results.find_runs import refuse_existing
from quadlog.results.page.blocks import render
from quadlog.results.page.planners import ComparedSource, planners_page, ratio_panel
from quadlog.results.planner_comparison.shown_questions import QuestionSample
from quadlog.results.planner_comparison.tables import REPLANS, SCENARIOS, format_rows, write_planners
from quadlog.results.tables import TableWriter
from quadlog.storage.atomic_write import new_folder, uninterrupted, write_whole

PAGE = "report.html"
TEXTS = {"planners.csv": "csv", "planners.json": "json", "planners.tex": "latex"}
TABLES = ("planners.parquet", "replans.parquet", "scenarios.parquet")


class ComparisonFiles:
    """Collects sources one by one; `finish` writes all files, and nothing is written if the block fails before.

    Files of an earlier comparison are replaced only with `force`, in `finish`. Entering raises AlreadyExists and
    CannotWrite.
    """

    def __init__(self, folder: Path, force: bool, has_queries: bool) -> None:
        self._folder, self._force, self._has_queries = folder, force, has_queries
        self._stack = ExitStack()
        self._sources: list[ComparedSource] = []

    def __enter__(self) -> Self:
        for path in _earlier_files(self._folder):
            refuse_existing(path, self._force)
        with ExitStack() as stack:
            stack.enter_context(new_folder(self._folder))
            self._replans = stack.enter_context(TableWriter(self._folder / "replans.parquet", REPLANS))
            if self._has_queries:
                self._scenarios = stack.enter_context(TableWriter(self._folder / "scenarios.parquet", SCENARIOS))
            stack.push(self._make_room)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def add(
        self,
        comparison: Comparison,
        replans: Mapping[str, NDArray[Any]],
        scenarios: Mapping[str, NDArray[Any]],
        sample: QuestionSample | None = None,
    ) -> None:
        """One source: its rows of replans.parquet and scenarios.parquet, and the questions that the page shows."""
        self._replans.append(replans)
        if len(scenarios["map"]):
            self._scenarios.append(scenarios)
        self._sources.append(ComparedSource(comparison, replans if sample is not None else {}, sample))

    def finish(self, rows: Sequence[Mapping[str, Any]], about: Sequence[str], losses: Sequence[str] = ()) -> None:
        """Write all files, report.html last; signals are delayed until then. Raises CannotWrite.

        about: how to read the rows; losses: what of recordings was lost.
        """
        from quadlog.results import mpl  # slow to import, and not needed where nothing is written

        panels = [ratio_panel(source.comparison) for source in self._sources]
        files = {f"plots/source-{n}-ratios.png": mpl.render([panel]) for n, panel in enumerate(panels, 1) if panel}
        files |= {name: format_rows(rows, to, about).encode() for name, to in TEXTS.items()}
        files[PAGE] = render(planners_page(self._sources, about, losses))
        with uninterrupted():
            self._stack.close()
            write_planners(self._folder / "planners.parquet", rows)
            for name, content in files.items():
                write_whole(self._folder / name, content)

    def _make_room(self, kind: type[BaseException] | None, *_: object) -> None:
        """Remove the files of an earlier comparison."""
        if kind is not None:
            return
        try:
            for path in _earlier_files(self._folder):
                path.unlink()
            (self._folder / "plots").mkdir(exist_ok=True)
        except OSError as error:
            raise CannotWrite(self._folder, error.strerror or str(error)) from error


def _earlier_files(folder: Path) -> list[Path]:
    """Files of an earlier comparison, report.html first."""
    named = (folder / name for name in (PAGE, *TEXTS, *TABLES))
    return [*(path for path in named if path.exists()), *sorted((folder / "plots").glob("source-[0-9]*-*.png"))]
