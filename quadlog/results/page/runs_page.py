"""One page for several runs: a folder of recordings, the seeds of a course, a sweep, or runs side by side.

What came out in a sentence, a list of the runs, the settings in which they differ, and where runs share a clock their
paths in one player and curves over each other, a colour for each run.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import numpy as np

from quadlog.errors import ExitCode, QuadlogError
from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.results.diff import unlike_settings
from quadlog.results.figures import FIGURES
from quadlog.results.find_runs import find_runs, is_run, run_name
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table
from quadlog.results.page.pack import Pack
from quadlog.results.page.verdict import status
from quadlog.results.run import Run
from quadlog.results.scenes import walk_scene
from quadlog.results.studies.sweep import SweepSummary, read_sweep_table, summarise_sweep, text_of
from quadlog.results.tables import read_table
from quadlog.results.text import (
    NONE,
    STATES,
    Bound,
    State,
    bounds_of,
    count,
    interval_text,
    label_of,
    state_of,
    value_text,
)
from quadlog.results.view import Moment, Scene, merge_panels, merge_scenes

if TYPE_CHECKING:
    from quadlog.metrics.differences import PairedDifference

MOST_DRAWN = 16
"""Runs whose paths and curves are drawn; the list has all."""
COLUMNS = 6
"""Metrics chosen for the list of runs; all of them are on demand."""
END_WORDS: dict[int, tuple[str, State]] = {0: ("done", ""), 1: ("failed", "bad"), 3: ("with loss", "warn")}


class Listed(NamedTuple):
    """A run of the list. name: of its folder; exit_code, reason: how its replay ended; metrics: its values by name."""

    name: str
    exit_code: int
    reason: str
    metrics: Mapping[str, float]
    run: Run | None


class Compared(NamedTuple):
    """Runs that are drawn over each other: by name, whether they share a clock, and what differs between the first
    and each other one. first_differences: instants at which results part.
    """

    runs: Mapping[str, Run]
    shares_clock: bool
    paired: Mapping[str, Mapping[str, PairedDifference]] = {}
    first_differences: Sequence[Moment] = ()


def list_page(
    title: str, rows: Sequence[Listed], findings: Sequence[Sentence], settings: blocks.Section | None = None
) -> blocks.Page:
    """The page of a folder of runs: findings and the list, worst first; paths and curves of runs of one recording."""
    runs = {row.name: row.run for row in rows if row.run is not None}
    one_clock = len({(run.record.input.identity, run.simulated) for run in runs.values()}) == 1 < len(runs)
    compared, pack = Compared(dict(list(runs.items())[:MOST_DRAWN]), one_clock), Pack()
    drawn = _over_each_other(compared, pack) if one_clock else []
    note = f"{count(len(runs) - MOST_DRAWN)} further runs are not drawn. " if len(runs) > MOST_DRAWN else ""
    failed = [f"{row.name}: {row.reason}" for row in rows if row.exit_code == ExitCode.FAILED]
    states: list[tuple[str, State]] = [(row.reason[:120], "") if row.run is None else status(row.run) for row in rows]
    every = runs_table("every-metric", rows, states, chosen_metrics(rows, len(CATALOGUE)))
    listed = runs_table("runs", rows, states, chosen_metrics(rows))
    sections = [
        blocks.Section("", [blocks.Verdict([*findings, *_ends(rows)]), listed]),
        *([settings] if settings else []),
        blocks.Section("Failed", [blocks.Notes("Not replayed", failed, "bad")] if failed else []),
        blocks.Section("Paths and curves", drawn, f"{note}{pack.thinned}"),
        blocks.Section("Settings that differ", settings_table(compared.runs)),
        blocks.Section("All metrics", [blocks.Details("A column for each metric", [every])] if rows else []),
    ]
    return blocks.Page(title, sections, [f"{count(len(rows))} run{'s' * (len(rows) != 1)}"], pack=pack)


def side_by_side_page(title: str, compared: Compared, notes: Sequence[str] = ()) -> blocks.Page:
    """The page of runs side by side: their metrics with differences to the first, paths, curves and settings."""
    pack = Pack()
    drawn = _over_each_other(compared, pack)
    said = {name: (run.title, *status(run)) for name, run in compared.runs.items()}
    statuses = [Sentence(name, f"{of}: {words}.", state) for name, (of, words, state) in said.items()]
    first: list[Any] = [blocks.Verdict([*_better(compared), *statuses])]
    sections = [
        blocks.Section("", first + ([blocks.Notes("Not comparable", notes)] if notes else [])),
        blocks.Section("Paths and curves", drawn, pack.thinned),
        blocks.Section("Metrics", [compared_metrics(compared)]),
        blocks.Section("Settings that differ", settings_table(compared.runs)),
    ]
    facts = [f"{len(compared.runs)} runs", "one clock" if compared.shares_clock else "each from its own start"]
    return blocks.Page(title, sections, facts, pack=pack)


def _opened(folder: Path, name: str) -> Run | None:
    """A run inside the folder; None for one that cannot be read, and for a name that leads elsewhere."""
    if any(part != run_name(part) for part in name.split("/")):
        return None
    try:
        return Run(folder / name)
    except QuadlogError:
        return None


def _ends(rows: Sequence[Listed]) -> list[Sentence]:
    """How many runs ended how."""
    often = Counter(row.exit_code for row in rows)
    found = [
        Sentence(word.capitalize(), f"{count(often[code])} of {count(len(rows))} runs.", state or "good")
        for code, (word, state) in END_WORDS.items() if often[code]
    ]  # fmt: skip
    return sorted(found, key=lambda line: STATES.index(line.state))


def chosen_metrics(rows: Sequence[Listed], most: int = COLUMNS) -> list[str]:
    """The metrics that matter most of those that any run has: the first of each theme, then the second, and so on."""
    there = {name for row in rows for name in row.metrics}
    ranked = [(place, name) for labels in THEMES.values() for place, name in enumerate(labels) if name in there]
    return [name for _, name in sorted(ranked, key=lambda item: item[0])[:most]]


def runs_table(name: str, rows: Sequence[Listed], states: Sequence[tuple[str, State]], metrics: Sequence[str]) -> Table:
    """The runs, worst first, with these metrics, coloured by bounds and alarms. states: status of each run."""
    found = []
    for row, (below, shown) in zip(rows, states, strict=True):
        word, state = END_WORDS.get(row.exit_code, (f"exit {row.exit_code}", "bad"))
        bounds = {} if row.run is None else bounds_of(row.run)
        cells = [_value_cell(metric, row.metrics.get(metric), bounds.get(metric)) for metric in metrics]
        href = "" if row.run is None else _link(row.name, row.run)
        found.append([Cell(row.name, href=href, below=below, state=state or shown), Cell(word, state=state), *cells])
    found.sort(key=lambda cells: (STATES.index(cells[1].state), STATES.index(cells[0].state)))
    columns = [Column("run"), Column("ended"), *map(_column, metrics)]
    return Table(columns, found, name, sortable=True, folded=100)


def _link(name: str, run: Run) -> str:
    """The run's page; its folder if it has none, as the runs of a sweep."""
    return f"./{quote(name)}/{'report.html' if (run.path / 'report.html').is_file() else ''}"


def _column(name: str) -> Column:
    unit = {"rad": "°"}.get(CATALOGUE[name].unit, CATALOGUE[name].unit)
    return Column(f"{label_of(name)}{f' ({unit})' if unit else ''}", True, help=f"{CATALOGUE[name].meaning} ({name})")


def _value_cell(name: str, value: float | None, bound: Bound | None = None) -> Cell:
    if value is None or not math.isfinite(value):
        return Cell(NONE, state="" if bound is None else bound.state)
    unit = CATALOGUE[name].unit
    return Cell(value_text(name, value, unit).removesuffix(f" {unit}"), value, state=state_of(name, value, bound))


def _over_each_other(compared: Compared, pack: Pack) -> list[Any]:
    """The paths of the runs in one player beside their curves, a colour for each run."""
    short = [re.sub(r"[^,/=]+=", "", name) for name in compared.runs]  # of a sweep the values alone
    names = short if len(set(short)) == len(short) else list(compared.runs)
    runs, charts = dict(zip(names, compared.runs.values(), strict=True)), []
    for figure in (figure for figure in FIGURES if figure.compared and figure.make is not walk_scene):
        made = {name: figure.make(run) for name, run in runs.items()}
        panels = {name: drawing for name, drawing in made.items() if drawing and not isinstance(drawing, Scene)}
        if panels:
            pack.add(figure.name, merge_panels(panels))
            charts.append(blocks.Drawn(figure.name, figure.title, figure.caption))
    scenes = {name: scene for name, run in runs.items() if (scene := walk_scene(run)) is not None}
    if not scenes:
        return charts
    pack.add("paths", merge_scenes(scenes))
    view = blocks.Drawn("paths", "paths", moments=compared.first_differences)
    return [blocks.Beside(view, charts)] if charts else [view]


def compared_metrics(compared: Compared) -> Table:
    """A row for each metric that a run has; differences to the first run, marked only where they are beyond chance."""
    names = list(compared.runs)
    rows: list[list[Cell]] = []
    same: list[list[Cell]] = []
    for metric in (metric for labels in THEMES.values() for metric in labels):
        found = {name: run.metrics[metric] for name, run in compared.runs.items() if metric in run.metrics}
        cells = [Cell(label_of(metric), below=metric)]
        for name in names:
            of, paired = found.get(name), compared.paired.get(name, {}).get(metric)
            below = "" if of is None else interval_text(metric, of.interval, of.unit)
            below = below if paired is None else _difference_text(metric, paired)
            text, value = (NONE, None) if of is None else (value_text(metric, of.value, of.unit), of.value)
            cells.append(Cell(text, value, below, state=_judged(metric, paired)))
        alike = len(found) == len(names) and len({of.value for of in found.values()}) == 1
        if found:
            (same if alike else rows).append(cells)
    note = f"Below: the 95 % interval, or the difference to {names[0]} on the instants that both have, coloured "
    note += "where it is beyond chance (all differences together, Bonferroni)."
    columns = [Column("metric"), *(Column(name, True) for name in names)]
    return Table(columns, [*rows, *same], "metrics-of-runs", note, folded=len(rows) if same and rows else None)


def _difference_text(name: str, paired: PairedDifference) -> str:
    if paired.same:
        return "the same"
    text = "+" * (paired.difference > 0) + value_text(name, paired.difference, CATALOGUE[name].unit, 2)
    interval = interval_text(name, paired.interval, CATALOGUE[name].unit)
    return f"{text} [{interval}]" if interval else text


def _judged(name: str, paired: PairedDifference | None) -> State:
    better = CATALOGUE[name].better
    if paired is None or not paired.clear or not better:
        return ""
    return "good" if (paired.difference > 0) == (better == "higher") else "bad"


def _better(compared: Compared) -> list[Sentence]:
    """In what the other runs are better or worse than the first, beyond chance."""
    first, found = next(iter(compared.runs)), []
    looks: dict[State, tuple[str, State]] = {"good": ("better", "good"), "bad": ("worse", "warn")}
    for name, paired in compared.paired.items():
        for judged, (word, state) in looks.items():
            clear = [metric for metric in paired if _judged(metric, paired[metric]) == judged]
            shown = [f"{label_of(metric)} ({_difference_text(metric, paired[metric])})" for metric in clear[:3]]
            more = f" and {len(clear) - 3} more" if len(clear) > 3 else ""
            if clear:
                found.append(Sentence(name, f"{word} than {first} beyond chance in {', '.join(shown)}{more}.", state))
    if compared.paired and not found:
        found.append(Sentence("Metrics", f"No difference to {first} is beyond chance."))
    return found


def settings_table(runs: Mapping[str, Run]) -> list[Table]:
    """Keys of configuration and options in which the runs differ, if there are any."""
    unlike = unlike_settings([run.record for run in runs.values()], NONE)
    rows = [[Cell(key, code=True), *(Cell(value[:80]) for value in of)] for key, of in unlike.items()]
    return [Table([Column("key"), *map(Column, runs)], rows, "settings")] if rows else []


def spread_of(rows: Sequence[Listed]) -> list[Sentence]:
    """Mean and sample deviation of the metrics that matter, over runs of one course."""
    found = []
    for name in chosen_metrics(rows, 4):
        values = np.array([row.metrics[name] for row in rows if name in row.metrics])
        if len(values) > 1:
            both = (value_text(name, float(of), CATALOGUE[name].unit) for of in (values.mean(), values.std(ddof=1)))
            text = f"{' ± '.join(both)} (mean and standard deviation of {len(values)} runs)."
            found.append(Sentence(label_of(name), text))
    return found


def write_folder_page(folder: Path) -> Path:
    """report.html of a folder of runs, from its summary.parquet. Raises NotARun, CannotWrite."""
    summary = read_table(folder, "summary")
    rows = []
    for number, name in enumerate(summary["recording"].tolist()):
        values = {key: float(summary[key][number]) for key in CATALOGUE if np.isfinite(summary[key][number])}
        code, reason = int(summary["exit_code"][number]), summary["reason"][number]
        rows.append(Listed(name, code, reason, values, _opened(folder, name)))
    known = {row.name for row in rows}
    inside = find_runs([folder]) if any(is_run(path) for path in folder.iterdir()) else []
    for name in (path.relative_to(folder).as_posix() for path in inside):
        if name not in known and (run := _opened(folder, name)) is not None:  # in an inner folder
            code = ExitCode.WITH_LOSS if run.record.losses else ExitCode.DONE
            rows.append(Listed(name, int(code), "", {key: of.value for key, of in run.metrics.items()}, run))
    simulated = [row.run.simulated for row in rows if row.run is not None]
    walks = bool(simulated) and all(simulated)
    title = f"{folder.resolve().name}: {count(len(rows))} {'walk' if walks else 'recording'}{'s' * (len(rows) != 1)}"
    return blocks.write_page(folder / "report.html", list_page(title, rows, spread_of(rows) if walks else []))


def write_sweep_page(folder: Path) -> Path:
    """report.html of a sweep, from its sweep.parquet. Raises NotARun, CannotWrite."""
    rows = read_sweep_table(folder)
    summary = summarise_sweep(rows)
    best = {name: summary.settings[summary.best[name]].label for name in summary.varying if name in summary.best}
    findings = [Sentence("Best", f"{label_of(name)}: {of}, beyond chance.", "good") for name, of in best.items()]
    listed = [Listed(row.run, row.exit_code, row.reason, row.metrics, _opened(folder, row.run)) for row in rows]
    title = f"{folder.resolve().name}: {' and '.join(summary.keys) or 'seeds'}"
    settings = blocks.Section("Settings", [_settings_values(summary), *map(blocks.Text, summary.notes())])
    return blocks.write_page(folder / "report.html", list_page(title, listed, findings, settings))


def _settings_values(summary: SweepSummary) -> Table:
    """A row for each combination: its values, and the mean of each metric that differs, with its interval."""
    columns = [*map(Column, summary.keys), Column("failed", True), *map(_column, summary.varying)]
    found = []
    for number, setting in enumerate(summary.settings):
        failed = sum(row.exit_code == ExitCode.FAILED for row in setting.rows)
        cells = [Cell(f"{failed} of {len(setting.rows)}", failed, state="bad" if failed else "")]
        for name in summary.varying:
            over = summary.over[name][number]
            below = interval_text(name, over.interval, CATALOGUE[name].unit)
            cell = _value_cell(name, over.mean, Bound("", "good" if summary.best.get(name) == number else ""))
            cells.append(cell._replace(below=below))
        found.append([*(Cell(text_of(value)) for value in setting.values.values()), *cells])
    return Table(columns, found, "settings-values", sortable=True)
