"""Metrics of runs as text: for people (table, markdown, latex) and for programs (json, csv)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from quadlog.errors import UnknownName
from quadlog.metrics.measured import MeasuredRun
from quadlog.metrics.spread import Spread
from quadlog.results.latex import WIDEST_PT, latex_document, latex_tables, width_pt
from quadlog.results.markdown import escape_markdown, markdown_table
from quadlog.results.metrics_sheet import Sheet, make_sheet
from quadlog.text import csv_table

Spreads = Mapping[str, Spread]

_WIDEST = 120
_CSV = ("run", "metric", "value", "unit", "n", "mean", "std", "p50", "p95", "low", "high")


def format_metrics(runs: Sequence[MeasuredRun], spreads: Spreads, to: str) -> str:
    """The runs' metrics as the format `to`, with a line end. Raises UnknownName."""
    if to not in FORMATS:
        raise UnknownName("format", to, FORMATS)
    return FORMATS[to](runs, spreads)


def json_text(runs: Sequence[MeasuredRun], _spreads: Spreads) -> str:
    """A list with one flat object per run: `run`, its path, and a plain number for each metric that it has."""
    objects = [{"run": _text(run.path), **{name: each.value for name, each in run.metrics.items()}} for run in runs]
    return json.dumps(objects, indent=2, allow_nan=False) + "\n"


def csv_text(runs: Sequence[MeasuredRun], _spreads: Spreads) -> str:
    """A row per run and metric, in full precision; a field is empty where there is nothing to say.

    mean, std, p50, p95 are those of the samples behind the value, low and high its 95 % interval.
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


def table_text(runs: Sequence[MeasuredRun], spreads: Spreads) -> str:
    """Aligned plain text; names of runs that would make it too wide are numbered, and told above."""
    sheet = make_sheet(runs, spreads)
    header = list(sheet.header)
    legend: list[str] = []
    if len(_line(header, _widths(header, sheet), sheet)) > _WIDEST:
        for column, label in enumerate(header):
            if column in sheet.names:
                header[column] = f"run {len(legend) + 1}"
                legend.append(f"{header[column]}: {label}")
    widths = _widths(header, sheet)
    lines = [_line(row, widths, sheet) for row in (header, *sheet.rows)]
    return "\n".join([sheet.caption, *legend, "", *lines, "", *sheet.notes]) + "\n"


def markdown_text(runs: Sequence[MeasuredRun], spreads: Spreads) -> str:
    """A table under its caption, the notes below."""
    sheet = make_sheet(runs, spreads)
    notes = "".join(f"\n{escape_markdown(note)}\n" for note in sheet.notes)
    table = markdown_table(sheet.header, sheet.rows, sheet.right)
    return f"{escape_markdown(sheet.caption)}\n\n{table}{notes}"


def latex_text(runs: Sequence[MeasuredRun], spreads: Spreads) -> str:
    """Floating tables in booktabs style; the notes as comments.

    What is too wide for a page has numbers for the runs' names, told below the table, or is two tables, or both.
    """
    named = make_sheet(runs, spreads)
    numbered, told = _numbered(named)
    candidates = [[named], [numbered], _divided(named), _divided(numbered)]
    fitting = (each for each in candidates if all(width_pt(part.header, part.rows) <= WIDEST_PT for part in each))
    tables: list[str] = []
    for part in next(fitting, candidates[-1]):

        def below(rows: Sequence[Sequence[str]], header: Sequence[str] = part.header) -> str:
            shown = {*header, *chain.from_iterable(rows)}
            return "; ".join(f"{short}: {name}" for short, name in told.items() if short in shown)

        label = "tab:metrics-more" if tables else "tab:metrics"
        tables += latex_tables(part.caption, label, part.header, part.rows, part.right, below=below)
    return latex_document(named.notes, tables)


FORMATS: dict[str, Callable[[Sequence[MeasuredRun], Spreads], str]] = {
    "table": table_text,
    "json": json_text,
    "csv": csv_text,
    "markdown": markdown_text,
    "latex": latex_text,
}


def _text(path: object) -> str:
    """A path as text that can be written: a file name may hold what is no text."""
    return str(path).encode("utf-8", "replace").decode()


def _numbered(sheet: Sheet) -> tuple[Sheet, dict[str, str]]:
    """The sheet with numbers for names, and the name that each of them stands for."""
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
    """The sheet as two, both with a metric's name and unit in front; as it is where it is not to be divided."""
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


def _widths(header: Sequence[str], sheet: Sheet) -> list[int]:
    return [max(map(len, column)) for column in zip(header, *sheet.rows, strict=True)]


def _line(cells: Sequence[str], widths: Sequence[int], sheet: Sheet) -> str:
    aligned = (
        cell.rjust(width) if name in sheet.right else cell.ljust(width)
        for cell, width, name in zip(cells, widths, sheet.header, strict=True)
    )
    return "  ".join(aligned).rstrip()
