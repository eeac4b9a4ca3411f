"""The picture of a table: every number that can be compared, with its interval, beside what the paper prints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.results import mpl
from quadlog.results.papers.table import PaperRow, PaperTable, Verdict
from quadlog.results.view import Panel, Series, Spread, forest

COLORS = {Verdict.YES: "robot", Verdict.NO: "target", Verdict.UNDECIDED: "note"}
WIDE = 30.0
"""Values farther apart than this factor get a logarithmic axis."""


def table_picture(table: PaperTable) -> bytes | None:
    """A PNG, a panel for each group and unit: ours as a dot with its interval, the printed number as a hollow one.

    None where nothing can be compared.
    """
    panels: list[Panel] = []
    for group in table.groups:
        units: dict[str, list[PaperRow]] = {}
        for row in group.rows:
            if row.reproduces in COLORS:
                units.setdefault(row.quantity.rpartition("(")[2].rstrip(")"), []).append(row)
        panels += [_panel(group.title, unit, rows) for unit, rows in units.items()]
    return mpl.render(panels) if panels else None


def _panel(title: str, unit: str, rows: list[PaperRow]) -> Panel:
    values = np.abs([value for row in rows for value in (row.ours, row.paper) if value is not None])
    log = bool(all(row.ours > 0 for row in rows) and values.min() > 0 and values.max() > WIDE * values.min())
    spreads = {}
    for row in rows:
        assert row.reproduces is not None
        interval = None if row.low is None or row.high is None else (row.low, row.high)
        spreads[f"{row.quantity.rpartition(' (')[0]} {row.claim}"] = Spread(
            row.ours, interval, (), COLORS[row.reproduces]
        )
    printed = [
        Series("printed", "text", np.array([row.paper]), np.array([place]), "points", variant=1)
        for place, row in enumerate(rows)
        if row.paper is not None
    ]
    panel = forest(f"{title} ({unit})", spreads, unit, log=log)
    return replace(panel, series=[*panel.series, *printed])
