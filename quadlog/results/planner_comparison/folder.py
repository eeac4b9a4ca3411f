"""The folder of a comparison: tables, plots, and a page that shows them.

Files: planners and replans as Parquet, scenarios.parquet with a .scen file, planners.csv, .json and .tex, plots/,
report.html, and README.md, which is written last. Nothing is written, and nothing of an earlier comparison is removed,
before all sources are compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from numpy.typing import NDArray

from quadlog.errors import CannotWrite
from quadlog.metrics.planning import Comparison
from quadlog.results.planner_comparison.page import PageSection, page_section, render_comparison
from quadlog.results.planner_comparison.shown_questions import ShownQuestions
from quadlog.results.planner_comparison.tables import REPLANS, SCENARIOS, format_rows, write_planners
from quadlog.results.plots.planner_comparison import PathScene, draw_cells, draw_paths, draw_ratios
from quadlog.results.plots.style import render_png
from quadlog.results.run.outputs import refuse_existing
from quadlog.results.run.tables import TableWriter
from quadlog.results.text.markup import escape_markdown
from quadlog.storage.atomic_write import new_folder, uninterrupted, write_whole

README, PAGE = "README.md", "report.html"
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
        self._sections: list[PageSection] = []
        self._plots: dict[str, bytes] = {}

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

    def finish(
        self,
        rows: Sequence[Mapping[str, Any]],
        findings: Sequence[str],
        about: Sequence[str],
        losses: Sequence[str] = (),
    ) -> None:
        """Write all files, README.md last; signals are delayed until then. Raises CannotWrite.

        losses: what of recordings was lost.
        """
        page = render_comparison(self._sections, about, losses, self._has_queries)
        with uninterrupted():
            self._stack.close()
            for name, png in self._plots.items():
                write_whole(self._folder / "plots" / name, png)
            write_whole(self._folder / PAGE, page)
            _write_comparison(self._folder, rows, findings, about)

    def add(
        self,
        comparison: Comparison,
        replans: Mapping[str, NDArray[Any]],
        scenarios: Mapping[str, NDArray[Any]],
        scene: PathScene | None,
        shown: ShownQuestions | None = None,
    ) -> None:
        """One source: its rows of replans.parquet and scenarios.parquet, its plots, and its part of the page."""
        self._replans.append(replans)
        if len(scenarios["map"]):
            self._scenarios.append(scenarios)
        number = len(self._sections) + 1
        drawn = {name: render_png(draw) for name, draw in _plots(comparison, replans, scene).items()}
        pictures = {name: png for name, png in drawn.items() if png is not None}
        self._plots |= {f"source-{number}-{name}.png": png for name, png in pictures.items()}
        self._sections.append(page_section(number, comparison, replans, shown, pictures))

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


def _write_comparison(
    folder: Path, rows: Sequence[Mapping[str, Any]], findings: Sequence[str], about: Sequence[str]
) -> None:
    """Planners in every format, and the page. Raises CannotWrite."""
    write_planners(folder / "planners.parquet", rows)
    for name, to in TEXTS.items():
        write_whole(folder / name, format_rows(rows, to, about).encode())
    pictures = _pictures(folder)
    blocks = [
        "# Planners compared",
        *map(escape_markdown, findings),
        format_rows(rows, "markdown", about).rstrip(),
        *(f"![{_alt(path)}](plots/{path.name})" for path in pictures),
    ]
    write_whole(folder / README, ("\n\n".join(blocks) + "\n").encode())


def _earlier_files(folder: Path) -> list[Path]:
    """Files of an earlier comparison, README.md first."""
    named = (folder / name for name in (README, PAGE, *TEXTS, *TABLES))
    return [*(path for path in named if path.exists()), *_pictures(folder)]


def _pictures(folder: Path) -> list[Path]:
    """In the order of the sources."""
    return sorted((folder / "plots").glob("source-[0-9]*-*.png"), key=lambda path: (_number(path), path.name))


def _number(path: Path) -> int:
    digits = path.stem.split("-")[1]
    return int(digits) if digits.isdecimal() else 0


def _alt(path: Path) -> str:
    _, number, *words = path.stem.split("-")
    return f"Source {number}: {' '.join(words)}."


def _plots(comparison: Comparison, replans: Mapping[str, NDArray[Any]], scene: PathScene | None) -> dict[str, Any]:
    """Drawing functions by file name."""
    first = replans["episode"] == 0
    planner = replans["planner"]
    names = [row.planner for row in comparison.rows]
    cells = {name: replans[comparison.counted][first & (planner == name)] for name in names}
    restarts = {
        row.planner: replans["from_scratch"][first & (planner == row.planner)]
        for row in comparison.rows
        if row.fallback_share is not None
    }
    medians = {
        row.planner: (row.ratio_expanded, row.ratio_low, row.ratio_high)
        for row in comparison.rows
        if row.ratio_expanded is not None
    }
    title = comparison.source
    plots: dict[str, Any] = {
        "ratios": partial(draw_ratios, comparison.episode_ratios, medians, comparison.baseline, title)
    }
    if len(cells[names[0]]) > 1:
        of = f"{title}, episode 1" if comparison.rows[0].episodes > 1 else title
        plots["cells-per-replan"] = partial(draw_cells, cells, restarts, comparison.baseline, of, comparison.counted)
    if scene is not None:
        plots["paths"] = partial(draw_paths, scene)
    return plots
