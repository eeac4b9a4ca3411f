"""Metrics of runs as text: tables in all formats, and the explanation of a metric with the worst instants of runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from quadlog.errors import UnknownName, csv_table, printable
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.intervals import Interval
from quadlog.metrics.summary import Measured, MeasuredRun, Spread
from quadlog.results.text.markup import (
    WIDEST_PT,
    aligned,
    escape_markdown,
    latex_document,
    latex_tables,
    markdown_table,
    width_pt,
)
from quadlog.results.text.numbers import significant


@dataclass(frozen=True, slots=True)
class WorstInstant:
    """A time stamp, seconds since the start of the run, and the sample."""

    t_ns: int
    since_start_s: float
    value: float


@dataclass(frozen=True, slots=True)
class RunAtWorst:
    """A run's value and its worst instants, the worst first; why_none: the reason if there are none.

    details: further lines on what is behind the value.
    """

    label: str
    value: float | None
    n: int
    instants: Sequence[WorstInstant]
    why_none: str = ""
    details: Sequence[str] = ()


def explain_text(name: str, runs: Sequence[RunAtWorst]) -> str:
    """Meaning, formula, source, unit and what n counts, of a metric of the catalogue; then each run."""
    entry = CATALOGUE[name]
    facts = [
        ("formula", entry.formula),
        ("source", entry.source),
        ("unit", entry.unit or "none"),
        ("n counts", entry.counted),
    ]
    lines = [f"{name}: {entry.meaning}", *(f"  {title:<9} {what}" for title, what in facts)]
    for run in runs:
        lines += ["", *_run_lines(run, entry.unit)]
    return "\n".join(lines) + "\n"


def _run_lines(run: RunAtWorst, unit: str) -> list[str]:
    if run.value is None:
        return [f"{printable(run.label)}: has no such metric"]
    title = f"{printable(run.label)}: {run.value:.6g} {unit}".rstrip() + f", n = {run.n}"
    details = [f"  {line}" for line in run.details]
    if not run.instants:
        return [f"{title}; {run.why_none}", *details]
    rows = [(str(each.t_ns), f"{each.since_start_s:.3f}", f"{each.value:.6g}") for each in run.instants]
    cells = [("t_ns", "s from start", f"sample {unit}".rstrip()), *rows]
    return [f"{title}; worst, at least 1 s apart:", *(f"  {line}" for line in aligned(cells)), *details]


MOST_COLUMNS = 6
_INTERVAL = "; low, high: 95 % interval"

_ONE_NOTE = (
    "mean, std, p50, p95: of the n samples behind a value, quantiles of their size; empty where no samples are saved.",
    "low, high: of the value, for walks as long as this one that go on as it did; neighbours in time count as",
    "dependent; empty below 100 samples, or where these are worth fewer than six independent ones.",
)
_MANY_NOTE = (
    "mean, std, p50, p95: over the runs that have the metric.",
    "low, high: of the mean over all such runs, independent and normally distributed (Student's t); of falls Wilson's;",
    "none of counts.",
)
_DIFFERING_NOTE = "The runs are listed and not averaged, because their settings differ:"
_WITHIN = "n, quantiles and intervals within each run: --format csv, or one run alone."


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table of printable text: rows of as many cells as the header.

    right: headings of columns of numbers. Columns are counted from 0: names, those headed by a run's name; naming,
    those that hold names of runs; rest, where a table too wide for a page is divided, 0 for nowhere.
    """

    caption: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    right: tuple[str, ...]
    notes: tuple[str, ...]
    names: range = range(0)
    naming: tuple[int, ...] = ()
    rest: int = 0


def make_sheets(runs: Sequence[MeasuredRun], spreads: Mapping[str, Spread], differing: Sequence[str]) -> list[Sheet]:
    """A row for each metric that any of the runs has, in the order of the catalogue; notes are on the last sheet.

    differing: how the settings of the runs differ, a line each; such runs are listed, MOST_COLUMNS to a sheet.
    """
    if len(runs) == 1:
        return [_one(runs[0])]
    if differing:
        parts = [runs[first : first + MOST_COLUMNS] for first in range(0, len(runs), MOST_COLUMNS)]
        notes = (_DIFFERING_NOTE, *(f"  {line}" for line in differing))
        return [_listed(part, notes if part is parts[-1] else ()) for part in parts]
    return [_few(runs, spreads) if len(runs) <= MOST_COLUMNS else _many(runs, spreads)]


def number(value: float | None) -> str:
    """Four significant digits, whole numbers without a point; nothing for None."""
    if value is not None and abs(value) < 1e15 and value == round(value):
        return str(int(value))
    return significant(value)


def ends(interval: Interval | None) -> tuple[str, str]:
    """Both ends of an interval, or nothing."""
    return ("", "") if interval is None else (number(interval[0]), number(interval[1]))


def _one(run: MeasuredRun) -> Sheet:
    numbers = ("value", "n", "mean", "std", "p50", "p95", "low", "high")
    rows = [(name, each.unit, *_summary_cells(each)) for name, each in run.metrics.items()]
    return Sheet(
        f"Metrics of {printable(run.label)}{_INTERVAL}", ("metric", "unit", *numbers), rows, numbers, _ONE_NOTE
    )


def _summary_cells(each: Measured) -> tuple[str, ...]:
    of = each.summary
    if of is None:
        return (number(each.value), str(each.n), "", "", "", "", "", "")
    spread = (number(of.mean), number(of.std), number(of.p50), number(of.p95), *ends(of.interval))
    return (number(each.value), str(each.n), *spread)


def _listed(runs: Sequence[MeasuredRun], notes: tuple[str, ...]) -> Sheet:
    labels = tuple(printable(run.label) for run in runs)
    rows = [
        (name, entry.unit, *(number(run.metrics[name].value) if name in run.metrics else "" for run in runs))
        for name, entry in CATALOGUE.items()
        if any(name in run.metrics for run in runs)
    ]
    caption = f"Metrics of {len(runs)} run{'s' if len(runs) > 1 else ''}"
    return Sheet(caption, ("metric", "unit", *labels), rows, labels, notes, range(2, 2 + len(runs)))


def _few(runs: Sequence[MeasuredRun], spreads: Mapping[str, Spread]) -> Sheet:
    labels = tuple(printable(run.label) for run in runs)
    numbers = (*labels, "mean", "std", "low", "high")
    rows = []
    for name, over in spreads.items():
        values = (number(run.metrics[name].value) if name in run.metrics else "" for run in runs)
        rows.append((name, CATALOGUE[name].unit, *values, number(over.mean), number(over.std), *ends(over.interval)))
    caption = f"Metrics of {len(runs)} runs{_INTERVAL}"
    names = range(2, 2 + len(runs))
    return Sheet(caption, ("metric", "unit", *numbers), rows, numbers, (*_MANY_NOTE, _WITHIN), names, rest=names.stop)


def _many(runs: Sequence[MeasuredRun], spreads: Mapping[str, Spread]) -> Sheet:
    numbers = ("runs", "mean", "std", "p50", "p95", "low", "high", "lowest", "highest")
    rows = []
    for name, over in spreads.items():
        have = [run for run in runs if name in run.metrics]
        lowest, highest = have[over.lowest], have[over.highest]
        middle = (str(over.runs), *map(number, (over.mean, over.std, over.p50, over.p95)), *ends(over.interval))
        extremes = ((number(run.metrics[name].value), printable(run.label)) for run in (lowest, highest))
        rows.append((name, CATALOGUE[name].unit, *middle, *chain.from_iterable(extremes)))
    header = ("metric", "unit", *numbers[:-1], "lowest in", "highest", "highest in")
    notes = (*_MANY_NOTE, "A row per run: --format json; n, quantiles and intervals within each: --format csv.")
    rest = header.index("lowest")
    caption = f"Metrics of {len(runs)} runs{_INTERVAL}"
    return Sheet(caption, header, rows, numbers, notes, naming=(rest + 1, rest + 3), rest=rest)


Spreads = Mapping[str, Spread]

_WIDEST = 120
_CSV = ("run", "metric", "value", "unit", "n", "mean", "std", "p50", "p95", "low", "high")


def format_metrics(runs: Sequence[MeasuredRun], spreads: Spreads, to: str, differing: Sequence[str] = ()) -> str:
    """The runs' metrics as the format `to`, with a line end; differing as in `make_sheets`. Raises UnknownName."""
    if to not in FORMATS:
        raise UnknownName("format", to, FORMATS)
    if to in _OF_RUNS:
        return _OF_RUNS[to](runs)
    return _OF_SHEETS[to](make_sheets(runs, spreads, differing))


def json_text(runs: Sequence[MeasuredRun]) -> str:
    """A list with one flat object per run: `run`, its path, and a plain number for each metric that it has."""
    objects = [{"run": _text(run.path), **{name: each.value for name, each in run.metrics.items()}} for run in runs]
    return json.dumps(objects, indent=2, allow_nan=False) + "\n"


def csv_text(runs: Sequence[MeasuredRun]) -> str:
    """A row per run and metric, in full precision; empty fields where there is no value.

    mean, std, p50, p95: of the samples behind the value; low, high: its 95 % interval.
    """
    rows: list[Sequence[object]] = [_CSV]
    for run in runs:
        for name, each in run.metrics.items():
            start = [_text(run.path), name, each.value, each.unit, each.n]
            if (of := each.summary) is None:
                rows.append([*start, *[""] * 6])
            else:
                low, high = of.interval or ("", "")
                rows.append([*start, of.mean, "" if of.std is None else of.std, of.p50, of.p95, low, high])
    return csv_table(rows)


def table_text(sheets: Sequence[Sheet]) -> str:
    """Aligned plain text; names of runs that would make it too wide are replaced by numbers, listed above."""
    return "\n".join(map(_table_text, sheets))


def _table_text(sheet: Sheet) -> str:
    told: dict[str, str] = {}
    lines = _sheet_lines(sheet)
    if sheet.names and len(lines[0]) > _WIDEST:
        sheet, told = _numbered(sheet)
        lines = _sheet_lines(sheet)
    legend = (f"{short}: {name}" for short, name in told.items())
    return "\n".join([sheet.caption, *legend, "", *lines, *([""] if sheet.notes else []), *sheet.notes]) + "\n"


def markdown_text(sheets: Sequence[Sheet]) -> str:
    """A table under its caption, the notes below."""
    return "\n".join(map(_markdown_text, sheets))


def _markdown_text(sheet: Sheet) -> str:
    notes = "".join(f"\n{escape_markdown(note)}\n" for note in sheet.notes)
    table = markdown_table(sheet.header, sheet.rows, sheet.right)
    return f"{escape_markdown(sheet.caption)}\n\n{table}{notes}"


def latex_text(sheets: Sequence[Sheet]) -> str:
    """Floating tables in booktabs style; the notes as comments.

    A table too wide for a page has numbers for the runs' names, listed below it, or is divided into two, or both.
    """
    tables: list[str] = []
    for sheet in sheets:
        tables += _latex_tables(sheet, len(tables))
    return latex_document(sheets[-1].notes, tables)


def _latex_tables(named: Sheet, before: int) -> list[str]:
    numbered, told = _numbered(named)
    candidates = [[named], [numbered], _divided(named), _divided(numbered)]
    fitting = (each for each in candidates if all(width_pt(part.header, part.rows) <= WIDEST_PT for part in each))
    tables: list[str] = []
    for part in next(fitting, candidates[-1]):

        def below(rows: Sequence[Sequence[str]], header: Sequence[str] = part.header) -> str:
            shown = {*header, *chain.from_iterable(rows)}
            return "; ".join(f"{short}: {name}" for short, name in told.items() if short in shown)

        count = before + len(tables)
        label = "tab:metrics" + (f"-{count + 1}" if count else "")
        tables += latex_tables(part.caption, label, part.header, part.rows, part.right, below=below)
    return tables


_OF_SHEETS: dict[str, Callable[[Sequence[Sheet]], str]] = {
    "table": table_text,
    "markdown": markdown_text,
    "latex": latex_text,
}
_OF_RUNS: dict[str, Callable[[Sequence[MeasuredRun]], str]] = {"json": json_text, "csv": csv_text}
FORMATS = (*_OF_SHEETS, *_OF_RUNS)


def _text(path: object) -> str:
    """A path as text that can be written: a file name may hold what is no text."""
    return str(path).encode("utf-8", "replace").decode()


def _numbered(sheet: Sheet) -> tuple[Sheet, dict[str, str]]:
    """The sheet with numbers in place of names of runs, and the names by number."""
    told: dict[str, str] = {}
    header, short = list(sheet.header), dict[str, str]()
    for column in sheet.names:
        header[column] = f"run {len(told) + 1}"
        told[header[column]] = sheet.header[column]
    rows = [list(row) for row in sheet.rows]
    for row in rows:
        for column in sheet.naming:
            name = row[column]
            row[column] = short.setdefault(name, f"run {len(short) + 1}")
            told[row[column]] = name
    right = (*sheet.right, *(header[column] for column in sheet.names))
    return replace(sheet, header=tuple(header), rows=[tuple(row) for row in rows], right=right), told


def _divided(sheet: Sheet) -> list[Sheet]:
    """The sheet divided into two, both with metric and unit; undivided if `rest` is 0."""
    if not sheet.rest:
        return [sheet]
    places = (range(sheet.rest), (0, 1, *range(sheet.rest, len(sheet.header))))
    return [
        replace(
            sheet,
            header=tuple(sheet.header[place] for place in columns),
            rows=[tuple(row[place] for place in columns) for row in sheet.rows],
        )
        for columns in places
    ]


def _sheet_lines(sheet: Sheet) -> list[str]:
    left = [column for column, name in enumerate(sheet.header) if name not in sheet.right]
    return aligned([sheet.header, *sheet.rows], left)
