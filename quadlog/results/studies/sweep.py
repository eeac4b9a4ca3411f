"""A sweep: sweep.parquet with a row for each run, and what the runs say together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from quadlog.errors import ExitCode, NotARun
from quadlog.messages import Float
from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.metrics.differences import OverRuns, clear_best, over_runs
from quadlog.results.tables import METRIC_NAMES, read_parquet, table_schema, write_table
from quadlog.results.text import print_table, shown, terminal_width

TABLE, PAGE = "sweep.parquet", "report.html"
SWEEP_METRICS = tuple(name for name in METRIC_NAMES if name not in THEMES["Computing"])
"""Without what depends on the machine's load, so that the table is the same whatever --jobs is."""
_ENDS = table_schema("seed:int run:text exit_code:int reason:text")
_METRICS = table_schema(" ".join(SWEEP_METRICS))


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One run. values: of the swept keys; run: the name of its folder; metrics: those it has."""

    values: Mapping[str, Any]
    seed: int
    run: str
    exit_code: int
    reason: str
    metrics: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """One flat object, as `--json` prints it."""
        known = {name: self.metrics[name] for name in SWEEP_METRICS if name in self.metrics}
        return {**self.values, **{name: getattr(self, name) for name in _ENDS.names}, **known}


def write_sweep_table(folder: Path, rows: Sequence[SweepRow]) -> None:
    """Write sweep.parquet. Keys are columns of their values' type; lists and mixed types are text.

    Raises CannotWrite.
    """
    keys = {key: _column([row.values[key] for row in rows]) for key in rows[0].values}
    fields = [pa.field(key, kind, nullable=False) for key, (kind, _) in keys.items()]
    flat = [row.to_dict() for row in rows]
    columns = {name: [of.get(name, np.nan) for of in flat] for name in (*_ENDS.names, *SWEEP_METRICS)}
    columns |= {key: values for key, (_, values) in keys.items()}
    write_table(folder / TABLE, pa.schema([*fields, *_ENDS, *_METRICS]), columns)


def _column(values: Sequence[Any]) -> tuple[pa.DataType, list[Any]]:
    """The type of a key's column, and its values: truth values, integers or numbers, else as text."""
    with suppress(pa.ArrowException, OverflowError):
        column = pa.array(values)
        if column.type in (pa.bool_(), pa.int64(), pa.float64()):
            return column.type, column.to_pylist()
    return pa.string(), [text_of(value) for value in values]


def read_sweep_table(folder: Path) -> list[SweepRow]:
    """The rows of sweep.parquet. Raises NotARun where it is missing, damaged or foreign, TooLarge."""
    table = read_parquet(folder / TABLE)
    kinds = dict(zip(table.column_names, table.schema.types, strict=True))
    foreign = [of.name for of in _ENDS if kinds.get(of.name) != of.type or table.column(of.name).null_count]
    foreign += [of.name for of in _METRICS if kinds.get(of.name, of.type) != of.type]
    if foreign:
        raise NotARun(folder / TABLE, f"is no table of a sweep, by its column {foreign[0]}")
    keys = table.column_names[: table.column_names.index("seed")]
    return [
        SweepRow(
            {key: row[key] for key in keys},
            metrics={name: row[name] for name in SWEEP_METRICS if row.get(name) is not None},
            **{name: row[name] for name in _ENDS.names},
        )
        for row in table.to_pylist()
    ]


def text_of(value: Any) -> str:
    """A value as a reader sees it: text itself, truth values as TOML has them, all else in Python's short form."""
    return str(value).lower() if isinstance(value, bool) else str(value)


class Setting(NamedTuple):
    """One combination of values, with its runs by rising seed. label: KEY=VALUE,…"""

    values: Mapping[str, Any]
    rows: list[SweepRow]
    label: str


class SweepSummary(NamedTuple):
    """varying: metrics that differ between runs. over: of each metric, by setting. above: its difference to the first
    setting, paired by seed. best: metric -> setting that is best beyond what seeds explain. seeded: metrics that differ
    between seeds.
    """

    keys: tuple[str, ...]
    settings: Sequence[Setting]
    seeds: int
    varying: Sequence[str]
    over: Mapping[str, Sequence[OverRuns]]
    above: Mapping[str, Sequence[OverRuns]]
    best: Mapping[str, int]
    seeded: frozenset[str]

    def notes(self) -> list[str]:
        """How far intervals and marks can be trusted, in sentences."""
        if self.seeds == 1:
            paired = "Intervals in the page are those of differences to the first value, sample by sample of one log"
            return [
                f"One seed: nothing is marked as best beyond chance. {paired}; --seeds N gives those of other draws."
            ]
        if not self.seeded:
            why = "no stage that ran draws random numbers that reach a metric"
            return [f"The {self.seeds} seeds change nothing here: {why}. Nothing has an interval or a mark."]
        means = (
            f"Means of {self.seeds} seeds with 95 % intervals (Student). A value is marked as best where its "
            "differences from all others, paired by seed, have intervals without 0 (95 % for all of them together, "
            "Bonferroni; each metric by itself)."
        )
        fixed = ", ".join(name for name in self.varying if name not in self.seeded)
        return [means, *([f"The seed does not change {fixed}: no interval, and no mark."] if fixed else [])]


def summarise_sweep(rows: Sequence[SweepRow]) -> SweepSummary:
    """The settings of a sweep in their order, and their metrics."""
    grouped: dict[str, Setting] = {}
    for row in sorted(rows, key=lambda row: row.seed):
        label = ",".join(f"{key}={text_of(value)}" for key, value in row.values.items())
        grouped.setdefault(label, Setting(row.values, [], label)).rows.append(row)
    settings, seeds = list(grouped.values()), sorted({row.seed for row in rows})
    tables = {name: table for name in SWEEP_METRICS if np.isfinite(table := _table(settings, seeds, name)).any()}
    varying = [name for name, table in tables.items() if np.nanmin(table) < np.nanmax(table)]
    over = {name: [over_runs(values) for values in table] for name, table in tables.items()}
    above = {name: [over_runs(values) for values in table - table[0]] for name, table in tables.items()}
    seeded = frozenset(name for name in varying if any(of.interval is not None for of in over[name]))
    better = {name: CATALOGUE[name].better for name in seeded if CATALOGUE[name].better}
    marks = {name: clear_best(tables[name], lower=side == "lower") for name, side in better.items()}
    best = {name: mark for name, mark in marks.items() if mark is not None}
    keys = tuple(rows[0].values) if rows else ()
    return SweepSummary(keys, settings, len(seeds), varying, over, above, best, seeded)


def _table(settings: Sequence[Setting], seeds: Sequence[int], name: str) -> Float:
    """A metric's values (C, S), NaN where a run has none."""
    of = [{row.seed: row.metrics.get(name, np.nan) for row in setting.rows} for setting in settings]
    return np.array([[values.get(seed, np.nan) for seed in seeds] for values in of])


MOST_METRICS = 4
BEST = "*"


def sweep_text(rows: Sequence[SweepRow]) -> str:
    """The combinations with up to MOST_METRICS metrics, means over seeds; `*` marks a best by SweepSummary.best."""
    summary = summarise_sweep(rows)
    metrics, lines = summary.varying[:MOST_METRICS], []
    for number, setting in enumerate(summary.settings):
        failed = sum(row.exit_code == ExitCode.FAILED for row in setting.rows)
        cells = [shown(summary.over[name][number].mean) + BEST * (summary.best.get(name) == number) for name in metrics]
        lines.append([*map(text_of, setting.values.values()), f"{failed}/{len(setting.rows)}", *cells])
    left_out = len(summary.varying) - len(metrics)
    more = [f"and {left_out} more metrics that differ, in report.html"] if left_out > 0 else []
    table = print_table([*summary.keys, "failed", *metrics], lines, width=terminal_width())
    return "\n".join([table.rstrip("\n"), *more, *summary.notes()])
