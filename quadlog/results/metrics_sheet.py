"""Metrics of runs as rows and columns for people: another layout for one run, for a few and for many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from quadlog.metrics.bootstrap import Interval
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.measured import Measured, MeasuredRun
from quadlog.metrics.spread import Spread
from quadlog.text import printable

MOST_COLUMNS = 6
_DIGITS = 4
_INTERVAL = "; low, high: 95 % interval"

_ONE_NOTE = (
    "mean, std, p50, p95: of the n samples behind a value, quantiles of their size; empty where no samples are saved.",
    "low, high: of the value, for walks as long as this one that go on as it did; neighbours in time count as",
    "dependent; empty below 100 samples, or where these are worth fewer than six independent ones.",
)
_MANY_NOTE = (
    "mean, std, p50, p95: over the runs that have the metric.",
    "low, high: of the mean over all such runs, independent and normally distributed (Student's t); of falls Wilson's.",
)
_WITHIN = "n, quantiles and intervals within each run: --format csv, or one run alone."


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table of printable text: rows of as many cells as the header.

    right: headings of columns that hold numbers. Columns are counted from 0: names, which are headed by a run's name;
    naming, which hold names of runs; rest, from where on a table too wide for a page goes on in another, 0 for nowhere.
    """

    caption: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    right: tuple[str, ...]
    notes: tuple[str, ...]
    names: range = range(0)
    naming: tuple[int, ...] = ()
    rest: int = 0


def make_sheet(runs: Sequence[MeasuredRun], spreads: Mapping[str, Spread]) -> Sheet:
    """A row for each metric that any of the runs has, in the contract's order."""
    if len(runs) == 1:
        return _one(runs[0])
    return _few(runs, spreads) if len(runs) <= MOST_COLUMNS else _many(runs, spreads)


def number(value: float | None) -> str:
    """Four significant digits, whole numbers whole; nothing for None."""
    if value is None:
        return ""
    if abs(value) < 1e15 and value == round(value):
        return str(int(value))
    if abs(value) >= 10 ** (_DIGITS - 1):
        return f"{value:.0f}"
    return f"{value:#.{_DIGITS}g}".rstrip(".") if abs(value) >= 1e-4 else f"{value:.{_DIGITS - 1}e}"


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
