"""Pictures of a sweep as SVG numbers: each metric over the values of a key, and all paths over the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.errors import QuadlogError
from quadlog.messages import Float
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.page.charts import MAX_RUNS, row_runs
from quadlog.results.plots.style import thin_points
from quadlog.results.run.tables import has_table, read_table
from quadlog.results.sweep.summary import Setting, SweepSummary, label_of
from quadlog.results.sweep.table import text_of
from quadlog.storage.formats.ros_map import read_rosmap

COLORS = 8
MAX_LINES = 2 * COLORS
"""Lines that can be told apart: by colour, and the second half by dashes."""
WIDTH, HEIGHT = 300.0, 170.0
LEFT, RIGHT, TOP, BOTTOM = 14.0, 14.0, 12.0, 30.0
"""Size and margins of a chart in SVG units; labels of the values are below."""
MAX_TICKS = 6
POINTS = 800
"""Points per path."""
MAP_WIDTH, LEAST_M, MARGIN_M = 900.0, 1.0, 0.5


@dataclass(frozen=True, slots=True)
class ValuePoint:
    """A mean over seeds, and the ends of its interval, at x; in SVG units. title: for the reader's pointer."""

    x: float
    y: float
    y_low: float | None
    y_high: float | None
    title: str
    best: bool


@dataclass(frozen=True, slots=True)
class ValueLine:
    """Means of one metric over the values of a key, the other keys fixed. color: number of a colour."""

    label: str
    color: int
    dashed: bool
    points: list[ValuePoint]

    @property
    def path(self) -> str:
        """All points, as SVG takes them."""
        return " ".join(f"{point.x},{point.y}" for point in self.points)


@dataclass(frozen=True, slots=True)
class ValueChart:
    """One metric over the values of `key`; joined: whether these are numbers, whose points a line connects.

    left_out: lines that are not drawn, as there are more than MAX_LINES.
    """

    name: str
    unit: str
    key: str
    joined: bool
    ticks: list[tuple[float, str]]
    low: float
    high: float
    lines: list[ValueLine]
    left_out: int


def value_charts(summary: SweepSummary) -> list[ValueChart]:
    """A chart for each metric that differs between settings; none without a key that varies."""
    key = _key_across(summary)
    if key is None:
        return []
    values = list(dict.fromkeys(setting.values[key] for setting in summary.settings))
    joined = _are_numbers(values)
    at = _places(np.array(values, dtype=np.float64) if joined else np.arange(len(values), dtype=np.float64))
    where = dict(zip(values, at.tolist(), strict=True))
    shown = thin_points(len(values), MAX_TICKS) if len(values) > MAX_TICKS else range(len(values))
    order = np.argsort(at)
    ticks = [(where[values[order[n]]], text_of(values[order[n]])) for n in shown]
    charts = (_chart(summary, name, key, joined, where, ticks) for name in summary.varying)
    return [chart for chart in charts if chart is not None]


def _key_across(summary: SweepSummary) -> str | None:
    """The key whose values go from left to right: the first one of numbers, else the first."""
    numbers = (key for key in summary.keys if _are_numbers([each.values[key] for each in summary.settings]))
    return next(numbers, summary.keys[0] if summary.keys else None)


def _are_numbers(values: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _places(values: Float) -> Float:
    span = float(np.ptp(values)) or 1.0
    inner = 10.0  # dots at the ends stay clear of the frame
    return np.round(LEFT + inner + (values - values.min()) / span * (WIDTH - LEFT - RIGHT - 2 * inner), 1)


def _chart(
    summary: SweepSummary,
    name: str,
    key: str,
    joined: bool,
    where: dict[Any, float],
    ticks: list[tuple[float, str]],
) -> ValueChart | None:
    over = summary.over[name]
    known = [end for each in over for end in each if end is not None and np.isfinite(end)]
    low, high = min(known), max(known)
    if low == high:
        return None

    def height(value: float | None) -> float | None:
        share = None if value is None else (value - low) / (high - low)
        return None if share is None else round(HEIGHT - BOTTOM - 8 - share * (HEIGHT - TOP - BOTTOM - 16), 1)

    lines: dict[str, list[ValuePoint]] = {}
    for number, (setting, each) in enumerate(zip(summary.settings, over, strict=True)):
        others = label_of({other: value for other, value in setting.values.items() if other != key})
        points = lines.setdefault(others, [])
        y = height(each.mean) if np.isfinite(each.mean) else None
        if y is not None:
            ends, title = (height(each.low), height(each.high)), f"{setting.label}: {each.mean:.4g}"
            points.append(ValuePoint(where[setting.values[key]], y, *ends, title, summary.best.get(name) == number))
    drawn = [
        ValueLine(label, number % COLORS, number >= COLORS, sorted(points, key=lambda point: point.x))
        for number, (label, points) in enumerate(lines.items())
        if number < MAX_LINES and points
    ]
    left_out = max(0, len(lines) - MAX_LINES)
    return ValueChart(name, CATALOGUE[name].unit, key, joined, ticks, low, high, drawn, left_out)


@dataclass(frozen=True, slots=True)
class OverlaidPath:
    """points: "x,y x,y" in SVG units."""

    label: str
    color: int
    dashed: bool
    points: str


@dataclass(frozen=True, slots=True)
class Overlay:
    """Paths of the settings from above, north up. what: which paths; logged: the robot's logged walk, empty if unknown.

    walls: an SVG path of the occupied cells; scale: SVG units per metre; left_out: settings that are not drawn.
    """

    what: str
    width: float
    height: float
    scale: float
    walls: str
    logged: str
    paths: list[OverlaidPath]
    left_out: int


_WALKED, _PLANNED, _LOCATED = "re-simulated walks", "plans", "positions of the robot"


def overlay(folder: Path, settings: Sequence[Setting]) -> Overlay | None:
    """The paths of up to MAX_LINES settings, each of its first run that can be read; None where there are none."""
    runs = [(setting, run) for setting in settings if (run := _first_run(folder, setting)) is not None]
    what, drawn = _paths(runs[:MAX_LINES])
    if not drawn:
        return None
    logged = _track(drawn[0][1], "poses") if what != _LOCATED else np.zeros((0, 2))
    everything = np.concatenate([*(points for _, _, points in drawn), logged])
    low, high = everything.min(axis=0) - MARGIN_M, everything.max(axis=0) + MARGIN_M
    across = np.maximum(high - low, LEAST_M)
    # A long north-south walk is not drawn taller than wide.
    scale = MAP_WIDTH / float(across.max())

    def svg(points: Float) -> str:
        kept = (points[thin_points(len(points), POINTS)] - [low[0], high[1]]) * [scale, -scale]
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in kept.tolist())

    number_of = {setting.label: number for number, setting in enumerate(settings)}
    paths = [
        OverlaidPath(setting.label, number % COLORS, number >= COLORS, svg(points))
        for setting, _, points in drawn
        if (number := number_of[setting.label]) < MAX_LINES
    ]
    width, height = (round(float(each) * scale, 1) for each in across)
    walls = _walls(drawn[0][1], low, high, scale)
    return Overlay(what, width, height, scale, walls, svg(logged), paths, len(settings) - len(paths))


def _first_run(folder: Path, setting: Setting) -> Path | None:
    names = (row.run for row in setting.rows if row.exit_code in (0, 3))
    return next((folder / name for name in names if "/" not in name and (folder / name).is_dir()), None)


def _paths(runs: Sequence[tuple[Setting, Path]]) -> tuple[str, list[tuple[Setting, Path, Float]]]:
    """What is drawn, and each setting's points (N, 2) in metres: of the latest stage that runs have."""
    if any(has_table(run, "control") for _, run in runs):
        what, found = _WALKED, [(setting, run, _track(run, "control")) for setting, run in runs]
    elif any(has_table(run, "paths") for _, run in runs):
        instant, plans = _plans_that_differ([run for _, run in runs])
        what = f"{_PLANNED} of the instant at which their lengths differ most, {instant} ns"
        found = [(setting, run, plan) for (setting, run), plan in zip(runs, plans, strict=True)]
    else:
        what, found = _LOCATED, [(setting, run, _track(run, "poses")) for setting, run in runs]
    return what, [each for each in found if len(each[2])]


def _track(run: Path, table: str) -> Float:
    """Positions (N, 2) of a table, those that are known; none of a run that cannot be read."""
    try:
        columns = read_table(run, table, ["x_m", "y_m"]) if has_table(run, table) else None
    except QuadlogError:
        columns = None
    if columns is None:
        return np.zeros((0, 2))
    points = np.column_stack([columns["x_m"], columns["y_m"]])
    return points[np.isfinite(points).all(axis=1)]


def _plans_that_differ(runs: Sequence[Path]) -> tuple[int, list[Float]]:
    """The instant at which the runs' smoothed plans differ most in length, and these plans (N, 2)."""
    plans = [_plans_of(run) for run in runs]
    spans: dict[int, list[float]] = {}
    for each in plans:
        for t_ns, points in each.items():
            spans.setdefault(t_ns, []).append(float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))
    if not spans:
        return 0, [np.zeros((0, 2)) for _ in runs]
    instant = max(spans, key=lambda t_ns: (len(spans[t_ns]), max(spans[t_ns]) - min(spans[t_ns]), -t_ns))
    return instant, [each.get(instant, np.zeros((0, 2))) for each in plans]


def _plans_of(run: Path) -> dict[int, Float]:
    """The smoothed plans (N, 2) of a run by their instant."""
    try:
        table = read_table(run, "paths", ["t_ns", "smooth_x_m", "smooth_y_m"])
    except QuadlogError:
        return {}
    points = np.column_stack([table["smooth_x_m"], table["smooth_y_m"]])
    order = np.argsort(table["t_ns"], kind="stable")
    t_ns, first = np.unique(table["t_ns"][order], return_index=True)
    pieces = np.split(points[order], first[1:]) if len(t_ns) else []
    return {int(instant): piece[np.isfinite(piece).all(axis=1)] for instant, piece in zip(t_ns, pieces, strict=True)}


def _walls(run: Path, low: Float, high: Float, scale: float) -> str:
    """Occupied cells of the run's map within the picture, as an SVG path; empty without a map, or with too many."""
    try:
        known = read_rosmap(run / "map.yaml") if (run / "map.yaml").is_file() else None
    except QuadlogError:
        known = None
    if known is None:
        return ""
    runs = row_runs(known.blocked)
    cell = known.cell_m
    left_m, bottom_m = known.origin_m[0] + runs[:, 1] * cell, known.origin_m[1] + runs[:, 0] * cell
    seen = (left_m + runs[:, 2] * cell > low[0]) & (left_m < high[0])
    seen &= (bottom_m + cell > low[1]) & (bottom_m < high[1])
    if np.count_nonzero(seen) > MAX_RUNS:
        return ""
    x, y = (left_m[seen] - low[0]) * scale, (high[1] - bottom_m[seen] - cell) * scale
    side = cell * scale
    return "".join(
        f"M{each_x:.1f} {each_y:.1f}h{length * side:.1f}v{side:.1f}h{-length * side:.1f}z"
        for each_x, each_y, length in zip(x.tolist(), y.tolist(), runs[seen, 2].tolist(), strict=True)
    )
