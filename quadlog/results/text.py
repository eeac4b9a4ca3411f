"""Tables for terminals, papers and scripts: one printer of header and rows, and the tables of metrics."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import ascii_uppercase
from typing import Any, NamedTuple

from quadlog.errors import csv_table, printable
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.intervals import Interval
from quadlog.metrics.summary import MeasuredRun, spread
from quadlog.results.numbers import minus, sig

_STYLES = {"table": "plain", "plain": "plain", "markdown": "pipe", "latex": "latex_booktabs"}
FORMATS = (*_STYLES, "csv", "json")
_NUMBER = re.compile(r"[-+\u2212]?\d[\d.\u2009 ]*(e[-+]?\d+)?\*?( ?%)?")
_NARROWEST = 12
_LATEX = {0x2212: "$-$", 0x2009: r"\,", 0x202F: r"\,", 0xFFFD: "?"}  # what pdflatex has no glyph for
_MARKDOWN_SPECIAL = re.compile(r"([\\`*_\[\]<>|~$&#])")
_LIST_ITEM = re.compile(r"^(\d*)([-+.)])(?=[\s-]|$)")  # what a paragraph must not begin with


def print_table(
    header: Sequence[str], rows: Sequence[Sequence[Any]], to: str = "plain", width: int | None = None
) -> str:
    """The table as text in one of FORMATS, with a line end; csv and json are for scripts, all else is for readers.

    Readers see four significant digits; scripts get numbers in full, an empty field (csv) or no entry (json) where
    there is none. Cells may hold anything: they are escaped, and control characters replaced. width: texts of a plain
    table are folded so that it fits.
    """
    if to == "json":
        objects = [{name: cell for name, cell in zip(header, row, strict=True) if _exists(cell)} for row in rows]
        return json.dumps(objects, indent=2, allow_nan=False) + "\n"
    if to == "csv":
        text = csv_table([header, *([cell if _exists(cell) else "" for cell in row] for row in rows)])
        return text.encode("utf-8", "replace").decode()  # a file name may hold what is no text
    from tabulate import tabulate

    escape = escape_markdown if to == "markdown" else printable
    cells = [[escape(cell) if isinstance(cell, str) else shown(cell) for cell in row] for row in rows]
    cells = cells or [[""] * len(header)]
    columns = zip(*cells, strict=True)
    right = [any(column) and all(_NUMBER.fullmatch(cell) or not cell for cell in column) for column in columns]
    align = ["right" if each else "left" for each in right]
    lines = [list(map(escape, header)), *cells]
    if _STYLES[to] == "plain":  # tabulate would widen columns below a header
        limits = None if width is None else _folded(lines, right, width)
        text = tabulate(lines, (), "plain", colalign=align, maxcolwidths=limits, disable_numparse=True)
    else:
        text = tabulate(cells, lines[0], _STYLES[to], colalign=align, disable_numparse=True)
    if to == "latex":
        # A bracket or star would be an option of the line end before it.
        text = re.sub(r"^ *(?=[\[*])", "{}", text.translate(_LATEX), flags=re.MULTILINE)
    return "".join(f"{line.rstrip()}\n" for line in text.split("\n"))


def _exists(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and not math.isfinite(value))


def shown(cell: Any) -> str:
    """A cell as readers see it."""
    if not _exists(cell):
        return ""
    return sig(cell, 4) if isinstance(cell, float) else minus(str(cell))


def _folded(lines: Sequence[Sequence[str]], keep: Sequence[bool], width: int) -> list[int]:
    """The width of each column: what is left beside the numbers is shared among texts.

    Words are broken only where the table does not fit otherwise.
    """
    columns = list(zip(*lines, strict=True))
    widths = [max(map(len, column)) for column in columns]
    texts = [at for at, kept in enumerate(keep) if not kept]
    left = width - 2 * (len(widths) - 1) - sum(widths[at] for at, kept in enumerate(keep) if kept)
    words = {at: max(len(word) for cell in columns[at] for word in cell.split() or [""]) for at in texts}
    floors = words if sum(words.values()) <= left else dict.fromkeys(texts, _NARROWEST)
    spare = left - sum(floors.values())
    for done, at in enumerate(sorted(texts, key=lambda at: widths[at] - floors[at])):
        more = max(0, min(widths[at] - floors[at], spare // (len(texts) - done)))
        widths[at] = min(widths[at], floors[at] + more)
        spare -= more
    return widths


def terminal_width() -> int:
    """Columns of the terminal; 80 where there is none."""
    return shutil.get_terminal_size().columns


def escape_markdown(text: str) -> str:
    """The text in one line, special characters escaped, control characters replaced."""
    return _LIST_ITEM.sub(r"\1\\\2", _MARKDOWN_SPECIAL.sub(r"\\\1", " ".join(printable(text).split())))


class TitledTable(NamedTuple):
    """A table of text or numbers under a title."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Any]]


def print_tables(tables: Sequence[TitledTable], to: str, notes: Sequence[str] = (), width: int | None = None) -> str:
    """Tables for readers below their titles, then notes; in latex titles and notes are comments."""
    if to == "markdown":
        blocks = [f"{escape_markdown(each.title)}\n\n{print_table(each.header, each.rows, to)}" for each in tables]
        return "\n".join([*blocks, *(f"{escape_markdown(note)}\n" for note in notes)])
    mark = "% " if to == "latex" else ""
    blocks = [f"{mark}{printable(each.title)}\n{print_table(each.header, each.rows, to, width)}" for each in tables]
    below = "".join(f"{mark}{printable(note)}\n" for note in notes)
    needs = "% needs \\usepackage{booktabs}\n" if to == "latex" else ""
    return needs + "\n".join([*blocks, *([below] if below else [])])


MOST_BESIDE = 4
"""Runs that are shown side by side."""
_LONGEST_LABEL = 10
_ONE_RUN = "95 %: interval of the value, neighbours in time counted as dependent; quantiles of samples: --format csv."
_OF_RUNS = "95 %: interval of the mean over all such runs (Student; of falls Wilson); every run: --format csv."
_CSV = ("run", "metric", "value", "unit", "n", "mean", "std", "p50", "p95", "low", "high")


def metrics_text(runs: Sequence[MeasuredRun], to: str, differing: Sequence[str] = ()) -> str:
    """The runs' metrics; differing: the settings in which they differ, a line each: such runs are not averaged.

    json: a flat object for each run, with `run`, its path. csv: a row for each run and metric, with mean, std and
    quantiles of the samples behind the value, and its 95 % interval.
    """
    if to == "json":
        names = list(dict.fromkeys(name for run in runs for name in run.metrics))
        rows = [[str(run.path), *(_value(run, name) for name in names)] for run in runs]
        return print_table(["run", *names], rows, to)
    if to == "csv":
        return print_table(_CSV, [_csv_row(run, name) for run in runs for name in run.metrics], to)
    if len(runs) == 1:
        (run,) = runs
        found = [(name, of.value, interval_text(of.interval), of.unit, of.n) for name, of in run.metrics.items()]
        tables = [TitledTable(f"Metrics of {run.label}", ("metric", "value", "95 %", "unit", "n"), found)]
        return print_tables(tables, to, [_ONE_RUN], terminal_width())
    values = {run.label: {name: of.value for name, of in run.metrics.items()} for run in runs}
    notes = ["The runs are not averaged, because their settings differ:", *differing] if differing else [_OF_RUNS]
    return values_text(values, to, notes, averaged=not differing)


def _value(run: MeasuredRun, name: str) -> float | None:
    return run.metrics[name].value if name in run.metrics else None


def _csv_row(run: MeasuredRun, name: str) -> Sequence[Any]:
    each = run.metrics[name]
    of, (low, high) = each.summary, each.interval or (None, None)
    spread_of = (None,) * 4 if of is None else (of.mean, of.std, of.p50, of.p95)
    return (str(run.path), name, each.value, each.unit, each.n, *spread_of, low, high)


def interval_text(interval: Interval | None, digits: int = 3) -> str:
    """Both ends of an interval, or nothing."""
    return "" if interval is None else f"{sig(interval[0], digits)} to {sig(interval[1], digits)}"


def values_text(
    runs: Mapping[str, Mapping[str, float]], to: str = "plain", notes: Sequence[str] = (), averaged: bool = True
) -> str:
    """Metrics of runs by label: side by side where they are few or not averaged, and how they spread over the runs."""
    known = {name for values in runs.values() for name in values}
    names = [*(name for name in CATALOGUE if name in known), *sorted(known - CATALOGUE.keys())]
    units = [CATALOGUE[name].unit if name in CATALOGUE else "" for name in names]
    labels, tables, legend = list(runs), [], []
    for first in range(0, len(labels), MOST_BESIDE) if len(labels) <= MOST_BESIDE or not averaged else ():
        mine = labels[first : first + MOST_BESIDE]
        short = max(map(len, mine)) > _LONGEST_LABEL and len(mine) > 1
        heads = list(ascii_uppercase[: len(mine)]) if short else mine
        legend += [f"{head}: {label}" for head, label in zip(heads, mine, strict=True)] if short else []
        rows = [
            (name, *(runs[label].get(name) for label in mine), unit) for name, unit in zip(names, units, strict=True)
        ]
        title = f"Metrics of {', '.join(mine)}"
        tables.append(TitledTable(title, ("metric", *heads, "unit"), rows))
    if averaged and len(labels) > 1:
        header = ("metric", "mean", "95 %", "lowest", "highest", "n")
        tables.append(TitledTable(f"Over {len(labels)} runs", header, [(name, *_spread(name, runs)) for name in names]))
    return print_tables(tables, to, [*legend, *notes], terminal_width())


def _spread(name: str, runs: Mapping[str, Mapping[str, float]]) -> tuple[Any, ...]:
    """Mean, interval, lowest and highest value, and number of runs that have the metric."""
    values = [float(of[name]) for of in runs.values() if name in of]
    over = spread(values, CATALOGUE[name].kind if name in CATALOGUE else "quantity")
    assert over is not None
    return over.mean, interval_text(over.interval, 2), min(values), max(values), over.runs


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
    facts = {"formula": entry.formula, "source": entry.source, "unit": entry.unit or "none", "n counts": entry.counted}
    lines = [f"{name}: {entry.meaning}", *(f"  {title:<9} {what}" for title, what in facts.items())]
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
    rows = [(each.t_ns, f"{each.since_start_s:.3f}", f"{each.value:.6g}") for each in run.instants]
    table = print_table(("t_ns", "s from start", f"sample {unit}".rstrip()), rows)
    return [f"{title}; worst, at least 1 s apart:", *(f"  {line}" for line in table.splitlines()), *details]
