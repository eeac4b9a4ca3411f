"""A sweep: sweep.parquet with a row for each run, and what the runs say together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from quadlog.errors import ExitCode, NotARun, TooLarge
from quadlog.messages import Float
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.comparison.over_seeds import OverSeeds, clear_best, over_seeds
from quadlog.results.tables import METRIC_NAMES, column_to_numpy, read_parquet, table_schema, write_table
from quadlog.results.text import print_table, shown, terminal_width

TABLE, PAGE = "sweep.parquet", "report.html"
SWEEP_METRICS = tuple(name for name in METRIC_NAMES if name != "realtime_factor")
"""Without what depends on the machine's load, so that the table is the same whatever --jobs is."""
_ENDS = table_schema("seed:int run:text exit_code:int reason:text")
_METRICS = table_schema(" ".join(SWEEP_METRICS))
_MOST_ROWS = 1_000_000


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
    columns: dict[str, Any] = {key: values for key, (_, values) in keys.items()}
    columns |= {name: [getattr(row, name) for row in rows] for name in _ENDS.names}
    columns |= {name: [row.metrics.get(name, np.nan) for row in rows] for name in SWEEP_METRICS}
    write_table(folder / TABLE, pa.schema([*fields, *_ENDS, *_METRICS]), columns)


def _column(values: Sequence[Any]) -> tuple[pa.DataType, list[Any]]:
    """The type of a key's column, and its values: of one type, integers among numbers as numbers, else as text."""
    types = {type(value) for value in values}
    if types == {bool}:
        return pa.bool_(), list(values)
    if types == {int} and all(abs(value) < 2**63 for value in values):
        return pa.int64(), list(values)
    if types <= {int, float} and np.isfinite([float(value) for value in values]).all():
        return pa.float64(), [float(value) for value in values]
    return pa.string(), [text_of(value) for value in values]


def read_sweep_table(folder: Path) -> list[SweepRow]:
    """The rows of sweep.parquet. Raises NotARun where it is missing, damaged or foreign, TooLarge."""
    path = folder / TABLE
    table = read_parquet(path)
    if table.num_rows > _MOST_ROWS:
        raise TooLarge(f"{path}: rows", table.num_rows, _MOST_ROWS)
    kinds = dict(zip(table.column_names, table.schema.types, strict=True))
    if not set(_ENDS.names) <= set(kinds) or len(kinds) < table.num_columns:
        raise NotARun(path, "is no table of a sweep")
    keys, metrics = list(kinds)[: list(kinds).index("seed")], [name for name in SWEEP_METRICS if name in kinds]
    wrong = [of.name for of in (*_ENDS, *_METRICS) if kinds.get(of.name, of.type) != of.type]
    wrong += [key for key in keys if kinds[key] not in (pa.bool_(), pa.int64(), pa.float64(), pa.string())]
    if wrong:
        raise NotARun(path, f"column {wrong[0]} has another type than in a table of a sweep")
    names = (*keys, *_ENDS.names, *metrics)
    columns = [column_to_numpy(path, table, name, kinds[name]).tolist() for name in names]
    rows = (dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True))
    return [
        SweepRow(
            {key: row[key] for key in keys},
            row["seed"],
            row["run"],
            row["exit_code"],
            row["reason"],
            {name: row[name] for name in metrics if np.isfinite(row[name])},
        )
        for row in rows
    ]


def text_of(value: Any) -> str:
    """A value as a reader sees it: text itself, truth values as TOML has them, all else in Python's short form."""
    return str(value).lower() if isinstance(value, bool) else str(value)


@dataclass(frozen=True, slots=True)
class Setting:
    """One combination of values, with its runs by rising seed. label: KEY=VALUE,…"""

    values: Mapping[str, Any]
    rows: Sequence[SweepRow]
    label: str


@dataclass(frozen=True, slots=True)
class SweepSummary:
    """varying: metrics that differ between runs. over: of each metric, by setting. best: metric -> setting that is best
    beyond what seeds explain. seeded: metrics that differ between seeds.
    """

    keys: tuple[str, ...]
    settings: Sequence[Setting]
    seeds: int
    varying: Sequence[str]
    over: Mapping[str, Sequence[OverSeeds]]
    best: Mapping[str, int]
    seeded: frozenset[str]

    def notes(self) -> list[str]:
        """How far intervals and marks can be trusted, in sentences."""
        if self.seeds == 1:
            return ["One seed: there are no intervals, and nothing is marked as best. --seeds N gives both."]
        if not self.seeded:
            why = "no stage that ran draws random numbers that reach a metric"
            return [f"The {self.seeds} seeds change nothing here: {why}. Nothing has an interval or a mark."]
        rule = "where its differences from all others, paired by seed, have intervals without 0"
        means = f"Means of {self.seeds} seeds with 95 % intervals (Student)."
        together = "95 % for all of them together, Bonferroni; each metric by itself"
        lines = [f"{means} A value is marked as best {rule} ({together})."]
        fixed = [name for name in self.varying if name not in self.seeded]
        if fixed:
            lines.append(f"The seed does not change {', '.join(fixed)}: no interval, and no mark.")
        return lines


def summarise_sweep(rows: Sequence[SweepRow]) -> SweepSummary:
    """The settings of a sweep in their order, and their metrics."""
    grouped: dict[str, list[SweepRow]] = {}
    for row in rows:
        grouped.setdefault(_label(row.values), []).append(row)
    settings = [
        Setting(each[0].values, sorted(each, key=lambda row: row.seed), label) for label, each in grouped.items()
    ]
    seeds = sorted({row.seed for row in rows})
    tables = {name: table for name in SWEEP_METRICS if np.isfinite(table := _table(settings, seeds, name)).any()}
    varying = [name for name, table in tables.items() if np.nanmin(table) < np.nanmax(table)]
    over = {name: [over_seeds(values) for values in table] for name, table in tables.items()}
    seeded = frozenset(name for name in varying if any(of.low is not None for of in over[name]))
    best = {}
    for name in seeded:
        better = CATALOGUE[name].better
        found = clear_best(tables[name], lower=better == "lower") if better else None
        if found is not None:
            best[name] = found
    return SweepSummary(tuple(rows[0].values) if rows else (), settings, len(seeds), varying, over, best, seeded)


def _table(settings: Sequence[Setting], seeds: Sequence[int], name: str) -> Float:
    """A metric's values (C, S), NaN where a run has none."""
    of = [{row.seed: row.metrics.get(name, np.nan) for row in setting.rows} for setting in settings]
    return np.array([[values.get(seed, np.nan) for seed in seeds] for values in of])


def _label(values: Mapping[str, Any]) -> str:
    """KEY=VALUE,…; empty without keys."""
    return ",".join(f"{key}={text_of(value)}" for key, value in values.items())


MOST_METRICS = 4
BEST = "*"


def sweep_text(rows: Sequence[SweepRow]) -> str:
    """The combinations with up to MOST_METRICS metrics, means over seeds; `*` marks a best by SweepSummary.best."""
    summary = summarise_sweep(rows)
    metrics = summary.varying[:MOST_METRICS]
    lines = []
    for number, setting in enumerate(summary.settings):
        failed = sum(row.exit_code == ExitCode.FAILED for row in setting.rows)
        means = [summary.over[name][number].mean for name in metrics]
        best = [summary.best.get(name) == number for name in metrics]
        cells = [shown(mean) + BEST * mark for mean, mark in zip(means, best, strict=True)]
        lines.append([*map(text_of, setting.values.values()), f"{failed}/{len(setting.rows)}", *cells])
    left_out = len(summary.varying) - len(metrics)
    more = [f"and {left_out} more metrics that differ, in report.html"] if left_out > 0 else []
    table = print_table([*summary.keys, "failed", *metrics], lines, width=terminal_width())
    return "\n".join([table.rstrip("\n"), *more, *summary.notes()])
