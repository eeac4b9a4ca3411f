"""The picture of a table: how far ours lies from what the paper prints or says, by the width of our interval."""

from __future__ import annotations

import numpy as np

from quadlog.results import mpl
from quadlog.results.papers.table import PaperRow, PaperTable, Verdict
from quadlog.results.view import Spread, forest

COLORS = {Verdict.YES: "robot", Verdict.NO: "target", Verdict.UNDECIDED: "note"}
MOST, HEAD, TAIL = 10.0, 42, 18
"""What lies farther off stands at the edge. Letters at the beginning and end of a long name that are kept."""
AXIS = "ours less print or claim, in half-widths of our interval"


def table_picture(table: PaperTable) -> bytes | None:
    """A PNG with a line for each row that can be compared and in which something is drawn; None without any."""
    rows: dict[str, Spread] = {}
    for row in table.rows:
        if (spread := _spread(row)) is not None:
            label = _label(row.quantity)
            rows[row.quantity if label in rows else label] = spread
    return mpl.render([forest(table.name, rows, AXIS, marks=[0.0])]) if rows else None


def _spread(row: PaperRow) -> Spread | None:
    printed = row.paper
    if printed is None and row.claim[:1] in ("<", ">"):
        printed = float(row.claim[1:])
    if row.reproduces not in COLORS or row.low is None or row.high is None or printed is None or row.low == row.high:
        return None
    places = (np.array([row.ours, row.low, row.high]) - printed) / ((row.high - row.low) / 2)
    ours, low, high = np.clip(places, -MOST, MOST).tolist()
    return Spread(ours, (low, high), color=COLORS[row.reproduces])


def _label(quantity: str) -> str:
    name = quantity.rpartition(" (")[0]
    return name if len(name) <= HEAD + TAIL else f"{name[:HEAD]}…{name[-TAIL:]}"
