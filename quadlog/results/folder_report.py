"""report.html of a folder of runs: a row for each recording, from summary.parquet."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from quadlog.errors import QuadlogError
from quadlog.results.files import write_whole
from quadlog.results.names import run_name
from quadlog.results.page import render_page
from quadlog.results.run_folder import read_run_json
from quadlog.results.schemas import COST_NAMES, METRIC_NAMES
from quadlog.results.small_multiples import WALKS, metric_charts, thumbnails
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

    `recording` is the name of the run's folder. Where all of them are simulated walks, seeds of one course, the page
    says so, and gives mean and sample deviation.

    Raises NotARun without a readable summary.parquet, CannotWrite.
    """
    summary = read_table(folder, "summary")
    shown = [name for name in METRIC_NAMES if np.isfinite(summary[name]).any()]
    costs = [name for name in COST_NAMES if np.isfinite(summary[name]).any()]
    rows = [_row(folder, summary, [*shown, *costs], index) for index in range(len(summary["recording"]))]
    walks = bool(rows) and all(_is_walk(folder, row["recording"]) for row in rows)
    counted = Counter(row["state"] for row in rows)
    tiles = [
        {"name": state, "count": counted[state], "kind": kind} for state, kind in _STATES.values() if counted[state]
    ]
    one, many = ("walk", "walks") if walks else ("recording", "recordings")
    drawn = thumbnails(folder, [row["recording"] for row in rows])
    report = folder / "report.html"
    content = render_page(
        "folder.html.jinja",
        scripts=("sort.js",),
        title=f"{folder.resolve().name}: {len(rows)} {one if len(rows) == 1 else many}",
        one=one,
        many=many,
        rows=rows,
        metrics=[*shown, *costs],
        workers=any(row["worker"] for row in rows),
        tiles=tiles,
        spread=_spread(summary, shown) if walks and len(rows) > 1 else [],
        charts=metric_charts(summary, shown),
        thumbnails=drawn,
        keys=[(color, name) for color, name in WALKS if any(color in dict(each.lines) for each in drawn)],
        links={row["recording"]: row["link"] for row in rows},
    )
    write_whole(report, content)
    return report


def _is_walk(folder: Path, recording: str) -> bool:
    """Whether a run of the folder is a simulated walk, by its own record."""
    if recording != run_name(recording):
        return False
    try:
        options = read_run_json(folder / recording).get("options")
    except QuadlogError:
        return False
    return isinstance(options, dict) and "course" in options


def _spread(summary: dict[str, Any], shown: list[str]) -> list[tuple[str, list[float | None]]]:
    """Mean and sample deviation of each metric over the runs that have it."""
    columns = [values[np.isfinite(values)] for values in (summary[name] for name in shown)]
    means = [float(values.mean()) for values in columns]
    return [
        ("mean", list(means)),
        ("std", [float(values.std(ddof=1)) if len(values) > 1 else None for values in columns]),
    ]


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
        "worker": summary["worker"][index],
        "link": _link(folder, str(summary["recording"][index])),
    }


def _link(folder: Path, recording: str) -> str | None:
    """Relative address of the run's own report; None where there is none, or where the name is no plain folder name."""
    if recording != run_name(recording) or not (folder / recording / "report.html").is_file():
        return None
    return f"./{quote(recording)}/report.html"
