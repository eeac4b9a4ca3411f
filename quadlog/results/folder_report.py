"""report.html of a folder of runs: a row for each recording, from summary.parquet."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from quadlog.results.files import write_whole
from quadlog.results.names import run_name
from quadlog.results.page import render_page
from quadlog.results.schemas import METRIC_NAMES
from quadlog.results.tables import read_table

# Exit codes of the contract: word, and the colour it is shown in.
_STATES = {
    0: ("done", "good"),
    1: ("failed", "bad"),
    2: ("usage", "bad"),
    3: ("with loss", "warn"),
    4: ("check", "bad"),
}


def write_folder_report(folder: Path) -> Path:
    """A page with a sortable row for each recording of summary.parquet, linked to the run's own report.

    `recording` is the name of the run's folder.

    Raises NotARun without a readable summary.parquet, CannotWrite.
    """
    summary = read_table(folder, "summary")
    shown = [name for name in METRIC_NAMES if np.isfinite(summary[name]).any()]
    rows = [_row(folder, summary, shown, index) for index in range(len(summary["recording"]))]
    counted = Counter(row["state"] for row in rows)
    tiles = [
        {"name": state, "count": counted[state], "kind": kind} for state, kind in _STATES.values() if counted[state]
    ]
    report = folder / "report.html"
    title = f"{folder.resolve().name}: {len(rows)} recordings"
    write_whole(
        report,
        render_page("folder.html.jinja", script="sort.js", title=title, rows=rows, metrics=shown, tiles=tiles),
    )
    return report


def _row(folder: Path, summary: dict[str, Any], shown: list[str], index: int) -> dict[str, Any]:
    exit_code = int(summary["exit_code"][index])
    state, kind = _STATES.get(exit_code, ("failed", "bad"))
    values = [float(summary[name][index]) for name in shown]
    return {
        "recording": summary["recording"][index],
        "exit_code": exit_code,
        "state": state,
        "kind": kind,
        "reason": summary["reason"][index],
        "metrics": [value if np.isfinite(value) else None for value in values],
        "link": _link(folder, str(summary["recording"][index])),
    }


def _link(folder: Path, recording: str) -> str | None:
    """Relative address of the run's own report; None where there is none, or where the name is no plain folder name."""
    if recording != run_name(recording) or not (folder / recording / "report.html").is_file():
        return None
    return f"./{quote(recording)}/report.html"
