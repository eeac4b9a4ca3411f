"""One page for the runs of a folder: a list to work with, then tracks and curves of runs of one recording; a sweep."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from quadlog.errors import ExitCode, QuadlogError
from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.results.find_runs import find_runs, is_run, run_name
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table, metric_cell
from quadlog.results.page.pack import Pack
from quadlog.results.page.side_by_side import Paired, settings_table, sweep_blocks, tracks_and_curves
from quadlog.results.page.verdict import verdict, walked_m
from quadlog.results.record import SavedMetric
from quadlog.results.run import Run
from quadlog.results.studies.sweep import read_sweep_table, summarise_sweep
from quadlog.results.tables import read_table
from quadlog.results.text import STATES, Bound, State, bounds_of, count, label_of, sig, unit_of, value_text
from quadlog.results.view import extent_of, thin_evenly

MOST_DRAWN = 16
"""Runs whose paths and curves are drawn; the list has all."""
COLUMNS = 6
"""Metrics chosen for the list of runs; summary.parquet and sweep.parquet have all."""
END_WORDS: dict[int, tuple[str, State]] = {1: ("failed", "bad"), 3: ("with loss", "warn"), 0: ("done", "")}
"""Worst first."""


class Listed(NamedTuple):
    """A run of the list. name: of its folder; exit_code, reason: how its replay ended."""

    name: str
    exit_code: int
    reason: str
    metrics: Mapping[str, SavedMetric]
    run: Run | None


def _listed(folder: Path, name: str, exit_code: int, reason: str, metrics: Mapping[str, float]) -> Listed:
    """A run inside the folder, without what is in it if it cannot be read or the name leads elsewhere."""
    run = None
    if all(part == run_name(part) for part in name.split("/")):
        with suppress(QuadlogError):
            run = Run(folder / name)
    known = {key: SavedMetric(of, 0, CATALOGUE[key].unit) for key, of in metrics.items() if math.isfinite(of)}
    lost = run is not None and run.record.losses
    code = ExitCode.WITH_LOSS if lost and exit_code == ExitCode.DONE else exit_code
    return Listed(name, code, reason, known if run is None else known | run.metrics, run)


def list_page(
    title: str, rows: Sequence[Listed], findings: Sequence[Sentence], first: Sequence[blocks.Section], pack: Pack
) -> blocks.Page:
    """The page of a folder of runs: findings and the list, worst first; tracks and curves of runs of one recording.

    first: sections before the list, whose drawings are in the pack.
    """
    runs = {row.name: row.run for row in rows if row.run is not None}
    one_clock = len({(run.record.input.identity, run.simulated) for run in runs.values()}) == 1 < len(runs)
    compared = dict(list(runs.items())[:MOST_DRAWN])
    drawn = tracks_and_curves(compared, pack, []) if one_clock else []
    note = f"{count(len(runs) - MOST_DRAWN)} further runs are not drawn. " if len(runs) > MOST_DRAWN else ""
    sections = [
        blocks.Section("", [blocks.Verdict([*findings, *_ends(rows)])]),
        *first,
        blocks.Section("Runs", [runs_table(rows)]),
        blocks.Section("Paths and curves", drawn, f"{note}{pack.thinned}"),
        blocks.Section("Settings that differ", settings_table(compared)),
    ]
    return blocks.Page(title, sections, [f"{count(len(rows))} run{'s' * (len(rows) != 1)}"], pack=pack)


def _ends(rows: Sequence[Listed]) -> Iterator[Sentence]:
    """How many runs ended how."""
    often = Counter(row.exit_code for row in rows)
    for code, (word, state) in END_WORDS.items():
        if often[code]:
            yield Sentence(word.capitalize(), f"{count(often[code])} of {count(len(rows))} runs.", state or "good")


def chosen_metrics(rows: Sequence[Listed], most: int = COLUMNS) -> list[str]:
    """The metrics that matter most of those that any run has: the first of each theme, then the second, and so on."""
    there = {name for row in rows for name in row.metrics} - {*THEMES["Computing"]}
    ranked = [(place, name) for labels in THEMES.values() for place, name in enumerate(labels) if name in there]
    return [name for _, name in sorted(ranked, key=lambda item: item[0])[:most]]


def runs_table(rows: Sequence[Listed]) -> Table:
    """The runs, worst first: track, worst sentence and metrics, coloured by bounds and alarms."""
    ends, metrics, found = len({row.exit_code for row in rows}) > 1, chosen_metrics(rows), []
    known = {name: [row.metrics[name].value for row in rows if name in row.metrics] for name in metrics}
    tops = {name: 1.0 if CATALOGUE[name].kind == "share" else max(known[name]) for name in metrics}
    for row in rows:
        word, state = END_WORDS.get(row.exit_code, (f"exit {row.exit_code}", "bad"))
        bounds = {} if row.run is None else bounds_of(row.run)
        worst = Sentence("", row.reason[:300], "bad") if row.run is None else verdict(row.run)[0]
        has_page = row.run is not None and (row.run.path / "report.html").is_file()  # else its folder is shown
        href = "" if row.run is None else f"./{quote(row.name)}/{'report.html' * has_page}"
        said = f"{worst.subject}: {worst.text}" if worst.subject else worst.text
        cells = [Cell(row.name, shlex.quote(row.name), _facts(row.run), href), *[Cell(word, state=state)] * ends]
        cells += [Cell("", track=_track(row.run)), Cell(said, STATES.index(worst.state), state=worst.state)]
        cells += [_value_cell(row, metric, bounds.get(metric), tops[metric]) for metric in metrics]
        found.append((STATES.index(state), STATES.index(worst.state), cells))
    found.sort(key=lambda of: of[:2])
    columns = [
        Column("run"),
        *[Column("ended")] * ends,
        Column("track", wide=True, sorts=False),
        Column("worst sentence"),
    ]
    note = "Bars reach from 0 to the largest of the list; the dark line is the 95 % interval."
    command = "quadlog report --side-by-side" if len(rows) > 1 else ""
    rows_found = [cells for *_, cells in found]
    return Table([*columns, *map(_column, metrics)], rows_found, "list", note, True, 100, command=command)


def _facts(run: Run | None) -> str:
    """Length of the recording, way, and where its positions come from."""
    poses = None if run is None else run.table("control" if run.simulated else "poses")
    if run is None or poses is None:
        return ""
    sources = [] if run.simulated else sorted(set(map(str, poses["source"])))
    return " · ".join([f"{sig(run.record.recorded_s)} s", f"{sig(walked_m(poses))} m", *sources])


POINTS = 150  # of a track in a thumbnail


def _track(run: Run | None) -> tuple[str, Sequence[tuple[str, str]]]:
    """The tracks of the robot, recorded and simulated, and contacts, in metres, as `Cell.track` has them."""
    names = {} if run is None else {"poses": "robot", "control": "resim", "contacts": "bad"}
    tables = {color: run.table(name) for name, color in names.items() if run is not None}
    if (contacts := tables.get("bad")) is not None:
        tables["bad"] = contacts[contacts["collision"]]
    places = {color: of[["x_m", "y_m"]].dropna().to_numpy() * (1, -1) for color, of in tables.items() if of is not None}
    lines = []
    for color, xy_m in places.items():
        points = [f"{x:.2f},{y:.2f}" for x, y in xy_m[thin_evenly(len(xy_m), POINTS)].tolist()]
        lines += [(color, f"{point} {point}") for point in points] if color == "bad" else [(color, " ".join(points))]
    boxes: Any = [xy_m.T for xy_m in places.values()] or [np.empty((2, 0))]
    left, right, top, bottom = extent_of(*boxes)
    return f"{left:.2f} {top:.2f} {right - left:.2f} {bottom - top:.2f}", lines


def _column(name: str) -> Column:
    unit = "" if CATALOGUE[name].kind in ("share", "factor") else unit_of(name, CATALOGUE[name].unit)[1]
    return Column(f"{label_of(name)}{f' ({unit})' if unit else ''}", True, help=f"{CATALOGUE[name].meaning} ({name})")


def _value_cell(row: Listed, name: str, bound: Bound | None, top: float) -> Cell:
    """A metric of a run, with a bar from 0 towards top, where that is not 0."""
    saved = row.metrics.get(name)
    cell = metric_cell(name, saved, bound)
    ends = () if saved is None else (saved.value, *(saved.interval or (0.0, 0.0)))
    bar: Any = (0.0, *(round(100 * min(max(of / top, 0.0), 1.0), 1) for of in ends)) if ends and top > 0 else None
    return cell._replace(text=cell.text.removesuffix(f" {CATALOGUE[name].unit}"), below="", bar=bar)


def spread_of(rows: Sequence[Listed]) -> Iterator[Sentence]:
    """Mean and sample deviation of the metrics that matter, over runs of one course."""
    for name in chosen_metrics(rows, 4):
        values = np.array([row.metrics[name].value for row in rows if name in row.metrics])
        if len(values) > 1:
            both = (value_text(name, float(of), CATALOGUE[name].unit) for of in (values.mean(), values.std(ddof=1)))
            text = f"{' ± '.join(both)} (mean and standard deviation of {len(values)} runs)."
            yield Sentence(label_of(name), text)


def write_folder_page(folder: Path) -> Path:
    """report.html of a folder of runs, from its summary.parquet. Raises NotARun, CannotWrite."""
    summary = read_table(folder, "summary")
    ends = zip(summary["recording"].tolist(), summary["exit_code"].tolist(), summary["reason"], strict=True)
    values = [{key: float(summary[key][number]) for key in CATALOGUE} for number in range(len(summary["recording"]))]
    rows = [_listed(folder, *of, metrics) for of, metrics in zip(ends, values, strict=True)]
    inside = find_runs([folder]) if any(is_run(path) for path in folder.iterdir()) else []
    deeper = {path.relative_to(folder).as_posix() for path in inside} - {row.name for row in rows}
    rows += filter(lambda row: row.run, (_listed(folder, name, 0, "", {}) for name in sorted(deeper)))
    simulated = [row.run.simulated for row in rows if row.run is not None]
    walks = bool(simulated) and all(simulated)
    title = f"{folder.resolve().name}: {count(len(rows))} {'walk' if walks else 'recording'}{'s' * (len(rows) != 1)}"
    page = list_page(title, rows, [*spread_of(rows)] if walks else [], [], Pack())
    return blocks.write_page(folder / "report.html", page)


def write_sweep_page(folder: Path, paired: Paired) -> Path:
    """report.html of a sweep, from its sweep.parquet. paired: by run, as far as it is known.

    Raises NotARun, CannotWrite.
    """
    rows, pack = read_sweep_table(folder), Pack()
    summary = summarise_sweep(rows)
    best = {name: summary.settings[summary.best[name]].label for name in summary.varying if name in summary.best}
    findings = [Sentence("Best", f"{label_of(name)}: {of}, beyond chance.", "good") for name, of in best.items()]
    listed = [_listed(folder, row.run, row.exit_code, row.reason, row.metrics) for row in rows]
    title = f"{folder.resolve().name}: {' and '.join(summary.keys) or 'seeds'}"
    first = blocks.Section("What the sweep changes", sweep_blocks(summary, paired, pack))
    return blocks.write_page(folder / "report.html", list_page(title, listed, findings, [first], pack))
