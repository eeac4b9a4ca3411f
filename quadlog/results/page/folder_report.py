"""report.html of a folder of runs: a row for each recording, from summary.parquet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from quadlog.errors import ExitCode, NotARun, QuadlogError
from quadlog.messages import Float
from quadlog.results.page.html import render_page
from quadlog.results.plots.style import thin_line, thin_points
from quadlog.results.run.find_runs import find_runs
from quadlog.results.run.names import run_name
from quadlog.results.run.run_folder import read_metrics, read_run_json
from quadlog.results.run.tables import COST_NAMES, METRIC_NAMES, has_table, read_table
from quadlog.storage.atomic_write import write_whole

MAX_RUNS = 200
"""Largest number of runs drawn in a chart; of more, extremes and a selection of the others are drawn."""
MAX_THUMBNAILS = 48
POINTS = 120
"""Points per walk in a thumbnail."""

WIDTH, HEIGHT, MARGIN = 240.0, 96.0, 6.0
"""Size of a chart in SVG units."""
SIDE = 120.0
"""Side of a thumbnail in SVG units."""

WALKS = (("robot", "robot"), ("target", "target"), ("note", "course"), ("resim", "simulated"))
"""Colour and name of each walk, in drawing order."""
_TABLES = (("poses", "robot"), ("target", "target"), ("control", "resim"))
_LEAST_M = 1.0


@dataclass(frozen=True, slots=True)
class Dot:
    """x, y: position in SVG units; run: its row in the table."""

    x: float
    y: float
    run: int
    value: float


@dataclass(frozen=True, slots=True)
class MetricChart:
    """One metric over the runs in order; median_y: height of the median line."""

    name: str
    dots: list[Dot]
    low: float
    median: float
    high: float
    median_y: float
    left_out: int


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """lines: colour and points "x,y x,y"; across_m: length of the side in metres."""

    recording: str
    lines: list[tuple[str, str]]
    across_m: float


def metric_charts(summary: Mapping[str, Any], names: Sequence[str]) -> list[MetricChart]:
    """A chart for each metric that differs between runs."""
    charts = (_metric_chart(name, np.asarray(summary[name], dtype=np.float64)) for name in names)
    return [chart for chart in charts if chart is not None]


def thumbnails(folder: Path, recordings: Sequence[str]) -> list[Thumbnail]:
    """Walks seen from above for up to MAX_THUMBNAILS runs that have positions, all at one scale.

    Runs whose tables cannot be read are left out.
    """
    walks = []
    for recording in recordings:
        if _is_inside(recording) and (found := _walks(folder / recording)):
            walks.append((recording, found))
        if len(walks) == MAX_THUMBNAILS:
            break
    longest_m = max((_across_m(found) for _, found in walks), default=_LEAST_M)
    across_m = longest_m * SIDE / (SIDE - 2 * MARGIN)
    return [Thumbnail(recording, _lines(found, across_m), across_m) for recording, found in walks]


def _metric_chart(name: str, values: Float) -> MetricChart | None:
    runs = np.flatnonzero(np.isfinite(values))
    present = values[runs]
    if len(present) < 2 or np.ptp(present) == 0:
        return None
    low, high = float(present.min()), float(present.max())
    keep = thin_line(present, MAX_RUNS)

    def height(value: Float | float) -> Any:
        return np.round(HEIGHT - MARGIN - (value - low) / (high - low) * (HEIGHT - 2 * MARGIN), 1)

    x = np.round(MARGIN + (runs[keep] + 0.5) / len(values) * (WIDTH - 2 * MARGIN), 1)
    dots = [
        Dot(*each)
        for each in zip(
            x.tolist(), height(present[keep]).tolist(), runs[keep].tolist(), present[keep].tolist(), strict=True
        )
    ]
    median = float(np.median(present))
    return MetricChart(name, dots, low, median, high, float(height(median)), len(present) - len(keep))


def _walks(run: Path) -> list[tuple[str, Float]]:
    """Colour and points (N, 2) in metres of each walk of a run."""
    # The paths of a simulated walk, which has no logged one, are its course.
    tables = _TABLES if has_table(run, "poses") else (("paths", "note"), *_TABLES)
    try:
        found = [(color, read_table(run, name, ["x_m", "y_m"])) for name, color in tables if has_table(run, name)]
    except QuadlogError:
        return []
    stacked = [(color, np.column_stack([table["x_m"], table["y_m"]])) for color, table in found]
    finite = [(color, points[np.isfinite(points).all(axis=1)]) for color, points in stacked]
    return [(color, points[thin_points(len(points), POINTS)]) for color, points in finite if len(points)]


def _box(walks: Sequence[tuple[str, Float]]) -> tuple[Float, Float]:
    points = np.concatenate([points for _, points in walks])
    return points.min(axis=0), points.max(axis=0)


def _across_m(walks: Sequence[tuple[str, Float]]) -> float:
    low, high = _box(walks)
    return max(_LEAST_M, float((high - low).max()))


def _lines(walks: Sequence[tuple[str, Float]], across_m: float) -> list[tuple[str, str]]:
    """Points in SVG units (y down), the walk centred."""
    low, high = _box(walks)
    scale = SIDE / across_m
    lines = []
    for color, points in walks:
        at = SIDE / 2 + (points - (low + high) / 2) * (scale, -scale)
        lines.append((color, " ".join(f"{x:.1f},{y:.1f}" for x, y in at.tolist())))
    return lines


# Exit codes of the contract: word, and the colour it is shown in.
_STATES = {
    0: ("done", "good"),
    1: ("failed", "bad"),
    2: ("usage", "bad"),
    3: ("with loss", "warn"),
    4: ("check", "bad"),
}


def write_folder_report(folder: Path) -> Path:
    """A page with a sortable row per recording of summary.parquet and per further run inside, linked to its page.

    `recording` is the name of the run's folder; of a run in an inner folder the way to it. If all are simulated walks,
    the page has mean and sample deviation.

    Raises NotARun without a readable summary.parquet, CannotWrite.
    """
    summary = _with_inner_runs(folder, read_table(folder, "summary"))
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


def _with_inner_runs(folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
    """The summary with a row for each run that `find_runs` finds in the folder and the summary does not have."""
    try:
        runs = [run.relative_to(folder).as_posix() for run in find_runs([folder])]
    except NotARun:
        return summary
    rows = [_row_of_run(folder, run) for run in runs if run not in set(summary["recording"]) and _is_inside(run)]
    if not rows:
        return summary
    empty = {name: "" if values.dtype == object else np.nan for name, values in summary.items()}
    return {
        name: np.concatenate([values, np.array([row.get(name, empty[name]) for row in rows], values.dtype)])
        for name, values in summary.items()
    }


def _row_of_run(folder: Path, run: str) -> dict[str, Any]:
    """Outcome and metrics of a run, by its own files; one that cannot be read, or is not finished, has failed."""
    try:
        record, metrics = read_run_json(folder / run), read_metrics(folder / run)
        lost = "; ".join(str(loss["detail"]) for loss in record.get("losses", []))
    except (QuadlogError, LookupError, TypeError) as error:
        return {"recording": run, "exit_code": int(ExitCode.FAILED), "reason": str(error)}
    values = {name: float(each["value"]) for name, each in metrics.items() if name in METRIC_NAMES}
    code = ExitCode.WITH_LOSS if lost else ExitCode.DONE
    return {"recording": run, "exit_code": int(code), "reason": lost, **values}


def _is_inside(recording: str) -> bool:
    """Whether it is a plain name of a folder, or the way to an inner one: no name in it leads elsewhere."""
    return all(part == run_name(part) for part in recording.split("/"))


def _is_walk(folder: Path, recording: str) -> bool:
    """Whether a run of the folder is a simulated walk, by its run.json."""
    if not _is_inside(recording):
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
    """Relative URL of the run's report; None if it does not exist or the name is not a plain folder name."""
    if not _is_inside(recording) or not (folder / recording / "report.html").is_file():
        return None
    return f"./{quote(recording)}/report.html"
