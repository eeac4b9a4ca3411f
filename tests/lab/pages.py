"""A page of every kind, made from the tests' tiny run."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from quadlog.pipelines.comparison.compare import compare
from quadlog.pipelines.comparison.sources import CompareOptions
from quadlog.pipelines.evaluation.reports import write_side_by_side, write_sweep
from quadlog.pipelines.executor.progress import Silent
from quadlog.results.page.blocks import Page, write_page
from quadlog.results.page.run_page import write_run_page
from quadlog.results.page.runs_page import write_folder_page
from quadlog.results.run import Run
from quadlog.results.studies.papers import PaperRow, PaperTable, RowGroup, Verdict, papers_page
from quadlog.results.studies.sweep import SweepRow, write_sweep_table
from quadlog.results.tables import TABLES, write_table
from tests.lab.runs import KINDS, change


def _folder(run: Path) -> Path:
    """A folder with this run, and one that failed."""
    names = [run.name, "broken"]
    columns: dict[str, Any] = {"recording": names, "exit_code": [0, 1], "reason": ["", "no lidar"], "eta_m": [0.1] * 2}
    write_table(run.parent / "summary.parquet", TABLES["summary"], columns)
    return write_folder_page(run.parent)


def _side_by_side(run: Path) -> Path:
    other = shutil.copytree(run, run.with_name("other"), dirs_exist_ok=True)
    change(other, "control", x_m=lambda x_m: x_m + 0.1, error_m=lambda error_m: error_m + 0.1)
    return write_side_by_side([run, other], run.with_name("two.html"), force=True)


def _sweep(run: Path) -> Path:
    rows = [SweepRow({"grid.dilation_m": 0.1 * k}, 0, run.name, 0, "", {"eta_m": 0.1 + k}) for k in range(3)]
    write_sweep_table(run.parent, rows)
    return write_sweep(run.parent)


def _planners(run: Path) -> Path:
    options = CompareOptions(planners=("ia_star", "dijkstra"), episodes=1)
    compare(["forest:0.1"], options, run.with_name("planners"), True, Silent())
    return run.with_name("planners") / "report.html"


def _papers(run: Path) -> Path:
    rows = (PaperRow("e", 7.0), *(PaperRow(f"{v} (m)", 1.23, 1.2, 1.0, 1.5, v, "why") for v in Verdict))
    groups = (RowGroup("Judged", "Text.", rows), RowGroup("Unprinted", "", (PaperRow("f", 7.0),)))
    table = PaperTable("one", "Title", "The `cap`.", "Sizes.", 0, True, groups)
    page: Page = papers_page([table])
    return write_page(run.with_name("papers.html"), page)


def _run(kind: str) -> Callable[[Path], Path]:
    def write(run: Path) -> Path:
        KINDS[kind](run)
        return write_run_page(Run(run))

    return write


PAGES: dict[str, Callable[[Path], Path]] = {
    **{kind: _run(kind) for kind in KINDS},
    "folder": _folder,
    "side by side": _side_by_side,
    "sweep": _sweep,
    "planners": _planners,
    "papers": _papers,
}
