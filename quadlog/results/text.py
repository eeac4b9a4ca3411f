"""Numbers, metrics and tables as people read them: in pages, figures, terminals and papers.

Scripts get numbers in full precision, from the csv and json of `print_table`.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from rich.cells import cell_len

from quadlog.errors import csv_table, printable
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.differences import over_runs
from quadlog.metrics.intervals import SHORTEST_S, Interval
from quadlog.metrics.positioning import by_chance
from quadlog.metrics.summary import MeasuredRun

if TYPE_CHECKING:
    from quadlog.results.record import SavedMetric
    from quadlog.results.run import Run

NONE = "–"
"""Shown for a value that does not exist."""


def sig(value: float | None, digits: int = 3) -> str:
    """Significant digits without trailing zeros; whole numbers and large ones in full; a true minus sign in pages."""
    if value is None or not math.isfinite(value):
        return NONE
    if (value == int(value) or round(abs(value)) >= 10**digits) and abs(value) < 1e15:
        return count(round(value))
    return minus(f"{value:.{digits}g}")


def count(number: float) -> str:
    """A whole number."""
    return minus(str(int(number)))


def percent(share: float | None, digits: int = 3) -> str:
    """A share as a percentage."""
    return NONE if share is None or not math.isfinite(share) else f"{sig(100 * share, digits)}\u202f%"


def minus(text: str) -> str:
    """The text of a number with a true minus sign."""
    return f"\u2212{text[1:]}" if text.startswith("-") else text


def ends_text(interval: Interval | None, digits: int = 3) -> str:
    """Both ends of an interval, or nothing."""
    return "" if interval is None else f"{sig(interval[0], digits)} to {sig(interval[1], digits)}"


State = Literal["good", "warn", "bad", ""]
"""How a sentence, value or row is coloured."""
STATES: tuple[State, ...] = ("bad", "warn", "good", "")
"""The worst first."""


def label_of(name: str) -> str:
    """The metric in words; a name that the catalogue lacks stays as it is."""
    return CATALOGUE[name].label if name in CATALOGUE else name


def unit_of(name: str, unit: str = "") -> tuple[float, str]:
    """The unit in which readers see a metric, and how many of it are one of the saved unit: shares in percent,
    angles in degrees, factors with ×.
    """
    kind = CATALOGUE[name].kind if name in CATALOGUE else "quantity"
    if kind == "share":
        return 100.0, "%"
    return (math.degrees(1), "°") if unit == "rad" else (1.0, "×" if kind == "factor" else unit)


def value_text(name: str, value: float, unit: str = "", digits: int = 3) -> str:
    """A value with its unit, as unit_of has it."""
    factor, shown_unit = unit_of(name, unit)
    text = sig(factor * value, digits)
    gap = {"%": "\u202f", "°": "", "": ""}.get(shown_unit, " ")
    return NONE if text == NONE else f"{text}{gap}{shown_unit}"


def interval_text(name: str, interval: Interval | None, unit: str = "") -> str:
    """A 95 % interval in the unit of value_text; empty without one, and for single events, of which it says nothing."""
    kind = CATALOGUE[name].kind if name in CATALOGUE else "quantity"
    if interval is None or kind in ("count", "yes or no"):
        return ""
    end = " ×" if kind == "factor" else f" {unit}"
    return " to ".join(value_text(name, of, unit, 2).removesuffix(end) for of in interval)


def interval_note(recorded_s: float) -> str:
    """What the 95 % intervals of a run's values are, or why it has none."""
    if recorded_s < SHORTEST_S:
        return f"95 %: {sig(recorded_s)} s are too short for an interval ({SHORTEST_S:g} s at least)"
    return "95 %: interval of the value, neighbours in time counted as dependent"


def is_alarming(name: str, of: SavedMetric) -> bool:
    """Whether a value is outside of what the catalogue takes as usual, and of what few independent errors explain."""
    alarm = CATALOGUE[name].alarm if name in CATALOGUE else None
    low, high = (math.inf, -math.inf) if of.independent is None else by_chance(name, of.independent)
    return alarm is not None and not min(alarm[0], low) <= of.value <= max(alarm[1], high)


class Bound(NamedTuple):
    """The expected range of a metric, and how it came out: `bad` also where the metric was not measured."""

    words: str
    state: State


def state_of(name: str, of: SavedMetric, bound: Bound | None) -> State:
    """How a value is coloured: by its bound, and without one by what is usual."""
    return bound.state if bound is not None else "warn" if is_alarming(name, of) else ""


def bounds_of(run: Run) -> dict[str, Bound]:
    """The bounds in the run's [expect], by metric."""
    found = {}
    for name, expected in (run.config.expect.model_extra or {}).items():
        unit, sides = CATALOGUE[name].unit, (("≥", expected.min), ("≤", expected.max))
        ends = [f"{sign} {value_text(name, end, unit)}" for sign, end in sides if end is not None]
        found[name] = Bound(" and ".join(ends), "good" if expected.holds(run.metric(name)) else "bad")
    return found


_STYLES = {"table": "plain", "plain": "plain", "markdown": "pipe", "latex": "latex_booktabs"}
FORMATS = (*_STYLES, "csv", "json")
_AMOUNT = r"[-+\u2212]?\d[\d. ]*(e[-+]?\d+)?"
_NUMBER = re.compile(rf"{_AMOUNT}\*?(| s|[ \u202f]?%| to {_AMOUNT}[\u202f%°]*)")
_FLAG = re.compile(r"""--[a-z]+ ('[^']*'|"[^"]*"|[^\s'";])+""")
_NARROWEST = 12
ASCII = {0x2212: "-", 0x202F: " "}
"""Numbers as awk and pandas read them: in terminals and Markdown."""
_LATEX = {0x2212: "$-$", 0x202F: r"\,", 0xFFFD: "?"}  # what pdflatex has no glyph for
_MARKDOWN_SPECIAL = re.compile(r"([\\`*_\[\]<>|~$&#])")
_LIST_ITEM = re.compile(r"^(\d*)([-+.)])(?=[\s-]|$)")  # what a paragraph must not begin with


def print_table(
    header: Sequence[str], rows: Sequence[Sequence[Any]], to: str = "plain", width: float = math.inf
) -> str:
    """The table as text in one of FORMATS, with a line end; csv and json are for scripts, all else is for readers.

    Readers see four significant digits; scripts get numbers in full, an empty field (csv) or no entry (json) where
    there is none. Cells may hold anything: they are escaped, and control characters replaced. width: of a plain
    table, as of table_rows.
    """
    if to == "json":
        objects = [{name: cell for name, cell in zip(header, row, strict=True) if _exists(cell)} for row in rows]
        return json.dumps(objects, indent=2, allow_nan=False) + "\n"
    if to == "csv":
        text = csv_table([header, *([cell if _exists(cell) else "" for cell in row] for row in rows)])
        return text.encode("utf-8", "replace").decode()  # a file name may hold what is no text
    if _STYLES[to] == "plain":
        return "".join(f"{line}\n".translate(ASCII) for lines in table_rows(header, rows, width) for line in lines)
    from tabulate import tabulate

    columns, right = _columns(header, rows, escape_markdown if to == "markdown" else printable)
    head, *cells = zip(*columns, strict=True)
    sides = ["right" if each else "left" for each in right]
    text = tabulate(cells or [("",) * len(head)], head, _STYLES[to], colalign=sides, disable_numparse=True)
    if to == "latex":
        # A bracket or star would be an option of the line end before it.
        text = re.sub(r"^ *(?=[\[*])", "{}", text.translate(_LATEX), flags=re.MULTILINE)
    return "".join(f"{line.rstrip()}\n" for line in text.translate(ASCII).split("\n"))


def table_rows(header: Sequence[str], rows: Sequence[Sequence[Any]], width: float = math.inf) -> list[list[str]]:
    """A plain table that fits `width` columns of a terminal: lines of the header, of each row, on what is left out.

    Names stay whole. Texts are folded at spaces; then long names of the first column get a line of their own; then
    columns of numbers are left out, the last ones first; then a row is broken between its cells.
    """
    columns, right = _columns(header, rows, printable)
    left_out = list[str]()
    while _excess(widths := _widths(columns, right, width), width) and any(right[1:]):
        at = max(at for at, number in enumerate(right) if number)
        left_out.insert(0, columns.pop(at)[0])
        del right[at]
    said = f"left out in {width} columns, but not in --json or --format csv: {', '.join(left_out)}"
    lines = [*(_lines(row, widths, right) for row in zip(*columns, strict=True)), [said] if left_out else []]
    return [[part for line in each for part in wrapped(line, width, "    ")] for each in lines]


def _columns(
    header: Sequence[str], rows: Sequence[Sequence[Any]], escape: Callable[[str], str]
) -> tuple[list[tuple[str, ...]], list[bool]]:
    """The texts of each column, its title first, and whether they are numbers."""
    cells = [[escape(cell) if isinstance(cell, str) else shown(cell) for cell in row] for row in rows]
    columns = list(zip(map(escape, header), *cells, strict=True))
    return columns, [any(of) and all(_NUMBER.fullmatch(cell) or not cell for cell in of) for _, *of in columns]


def _widths(columns: Sequence[Sequence[str]], right: Sequence[bool], width: float) -> list[int]:
    """The width of each column where texts are folded, and then the first one narrowed, until the table fits."""
    widths = [max(map(cell_len, column)) for column in columns]
    words = [max(cell_len(word) for cell in column for word in wrapped(cell, 0)) for column in columns]
    texts = [at for at, number in enumerate(right) if at and not number]
    while _excess(widths, width) and (wide := [at for at in texts if widths[at] > max(words[at], _NARROWEST)]):
        widths[max(wide, key=widths.__getitem__)] -= 1
    widths[0] -= 0 if right[0] else min(_excess(widths, width), widths[0])
    return widths


def _excess(widths: Sequence[int], width: float) -> int:
    return int(max(sum(widths) + 2 * (len(widths) - 1) - width, 0))


def _lines(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> list[str]:
    """A row of a table; a first cell that is wider than its column has a line of its own."""
    name, *others = cells
    alone = [name] if cell_len(name) > widths[0] else []
    parts = [wrapped(cell, size) for cell, size in zip(["" if alone else name, *others], widths, strict=True)]
    for texts in zip_longest(*parts, fillvalue=""):
        blanks = [" " * (size - cell_len(text)) for text, size in zip(texts, widths, strict=True)]
        padded = [gap + text if number else text + gap for text, gap, number in zip(texts, blanks, right, strict=True)]
        alone += filter(None, ["  ".join(padded).rstrip()])
    return alone


def wrapped(text: str, width: float, indent: str = "") -> list[str]:
    """The text in lines of so many columns of a terminal, broken at spaces: longer words, and flags to paste, whole."""
    first, *words = _FLAG.sub(lambda flag: flag[0].replace(" ", "\xa0"), text).split(" ")
    lines = [first]
    for word in words:
        if cell_len(lines[-1]) + 1 + cell_len(word) <= width or not lines[-1].strip():
            lines[-1] += f" {word}"
        elif word:
            lines.append(indent + word)
    return [line.replace("\xa0", " ").rstrip() for line in lines]


def _exists(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and not math.isfinite(value))


def shown(cell: Any) -> str:
    """A cell as readers see it."""
    return "" if not _exists(cell) else sig(cell, 4) if isinstance(cell, float) else minus(str(cell))


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


def print_tables(tables: Sequence[TitledTable], to: str, notes: Sequence[str] = (), width: float = math.inf) -> str:
    """Tables for readers below their titles, then notes; in latex titles and notes are comments."""
    escape, gap = (escape_markdown, "\n") if to == "markdown" else (printable, "")
    mark, needs = ("% ", "% needs \\usepackage{booktabs}\n") if to == "latex" else ("", "")
    blocks = [f"{mark}{escape(of.title)}\n{gap}{print_table(of.header, of.rows, to, width)}" for of in tables]
    below = gap.join(f"{mark}{escape(note)}\n" for note in notes)
    return needs + "\n".join([*blocks, *filter(None, [below])])


MOST_BESIDE, _LONGEST_LABEL = 4, 10
"""Runs that are shown side by side, and the label of a column."""
_CSV = ("run", "metric", "value", "unit", "n", "mean", "std", "p50", "p95", "low", "high")


def metrics_text(runs: Sequence[MeasuredRun], to: str, differing: Sequence[str] = ()) -> str:
    """The runs' metrics; differing: the settings in which they differ, a line each: such runs are not averaged.

    json: a flat object for each run, with `run`, its path. csv: a row for each run and metric, with mean, std and
    quantiles of the samples behind the value, and its 95 % interval.
    """
    values = {run.label: {name: of.value for name, of in run.metrics.items()} for run in runs}
    if to == "json":
        names = list(dict.fromkeys(name for of in values.values() for name in of))
        rows = [[str(run.path), *map(values[run.label].get, names)] for run in runs]
        return print_table(["run", *names], rows, to)
    if to == "csv":
        every = [(str(run.path), name, of) for run in runs for name, of in run.metrics.items()]
        ends = [[*map(of.detail.get, _CSV[5:9]), *(of.interval or (None, None))] for *_, of in every]
        rows = [[path, name, of.value, of.unit, of.n, *end] for (path, name, of), end in zip(every, ends, strict=True)]
        return print_table(_CSV, rows, to)
    if len(runs) == 1:
        (run,) = runs
        found = [(name, of.value, ends_text(of.interval), of.unit, of.n) for name, of in run.metrics.items()]
        tables = [TitledTable(f"Metrics of {run.label}", ("metric", "value", "95 %", "unit", "n"), found)]
        note = f"{interval_note(run.recorded_s)}; quantiles of samples: --format csv."
        return print_tables(tables, to, [note], terminal_width())
    notes = ["95 %: interval of the mean over all such runs (Student; of falls Wilson); every run: --format csv."]
    if differing:
        notes = ["The runs are not averaged, because their settings differ:", *differing]
    return values_text(values, to, notes, averaged=not differing)


def values_text(
    runs: Mapping[str, Mapping[str, float]], to: str = "plain", notes: Sequence[str] = (), averaged: bool = True
) -> str:
    """Metrics of runs by label: side by side where they are few or not averaged, and how they spread over the runs."""
    known = {name for values in runs.values() for name in values}
    units = {name: CATALOGUE[name].unit for name in CATALOGUE if name in known}
    units |= dict.fromkeys(sorted(known - CATALOGUE.keys()), "")
    labels, tables, legend = list(runs), [], list[str]()
    for first in range(0, len(labels), MOST_BESIDE) if len(labels) <= MOST_BESIDE or not averaged else ():
        heads = mine = labels[first : first + MOST_BESIDE]
        if max(map(cell_len, mine)) > _LONGEST_LABEL and len(mine) > 1:
            heads = list(ascii_uppercase[: len(mine)])
            legend += map(": ".join, zip(heads, mine, strict=True))
        rows = [(name, *(runs[label].get(name) for label in mine), unit) for name, unit in units.items()]
        tables.append(TitledTable(f"Metrics of {', '.join(mine)}", ("metric", *heads, "unit"), rows))
    if averaged and len(labels) > 1:
        header = ("metric", "mean", "95 %", "lowest", "highest", "n")
        tables.append(TitledTable(f"Over {len(labels)} runs", header, [_spread(name, runs) for name in units]))
    return print_tables(tables, to, [*legend, *notes], terminal_width())


def _spread(name: str, runs: Mapping[str, Mapping[str, float]]) -> tuple[Any, ...]:
    """The metric, its mean, interval, lowest and highest value, and the number of runs that have it."""
    values = [float(of[name]) for of in runs.values() if name in of]
    over = over_runs(np.array(values), CATALOGUE[name].kind if name in CATALOGUE else "quantity")
    return name, over.mean, ends_text(over.interval, 2), min(values), max(values), over.runs


def explain_text(name: str, runs: Mapping[str, Sequence[str]]) -> str:
    """Meaning, formula, source, unit and what n counts, of a metric of the catalogue; then the lines of each run."""
    entry = CATALOGUE[name]
    facts = {"formula": entry.formula, "source": entry.source, "unit": entry.unit or "none", "n counts": entry.counted}
    lines = [f"{name}: {entry.meaning}", *(f"  {title:<9} {what}" for title, what in facts.items())]
    for label, (first, *more) in runs.items():
        lines += ["", f"{printable(label)}: {first}", *(f"  {line}" for line in more)]
    return "\n".join(lines) + "\n"
