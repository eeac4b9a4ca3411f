"""Pictures of the planning tables: ratios run by run, and cells replan by replan of the first run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.planner_walks import Spent
from quadlog.results.plots.comparison import Median, draw_cells, draw_ratios

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_all_ratios(spent: Mapping[str, tuple[Spent, str]], printed: Mapping[str, Float], title: str) -> Figure | None:
    """A line for each label's (source, planner) and for each printed table: its ratios, their median and interval."""
    ratios: dict[str, Float] = {label: each.ratios(planner) for label, (each, planner) in spent.items()}
    medians: dict[str, Median] = {label: _median(each, planner) for label, (each, planner) in spent.items()}
    for label, of_runs in printed.items():
        ratios[label], medians[label] = of_runs, (float(np.median(of_runs)), None, None)
    return draw_ratios(ratios, medians, "A*", title)


def _median(spent: Spent, planner: str) -> Median:
    row = spent.row(planner)
    assert row.ratio_expanded is not None
    return row.ratio_expanded, row.ratio_low, row.ratio_high


def draw_first_run(spent: Spent, title: str) -> Figure | None:
    """Cells of every planner in each replan of the first run [Planning, Fig. 18]."""
    comparison, columns = spent.comparison, spent.columns
    of = {row.planner: (columns["episode"] == 0) & (columns["planner"] == row.planner) for row in comparison.rows}
    cells = {name: columns[comparison.counted][mine] for name, mine in of.items()}
    restarts = {
        row.planner: columns["from_scratch"][of[row.planner]]
        for row in comparison.rows
        if row.fallback_share is not None
    }
    return draw_cells(cells, restarts, comparison.baseline, title, comparison.counted)
