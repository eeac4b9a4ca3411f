"""sweep.parquet: a row for each run of a sweep, with its settings, its end and its metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from quadlog.errors import NotARun, TooLarge
from quadlog.results.tables import METRIC_NAMES, column_to_numpy, read_parquet, write_table

TABLE, PAGE = "sweep.parquet", "report.html"
SWEEP_METRICS = tuple(name for name in METRIC_NAMES if name != "realtime_factor")
"""Without what depends on the machine's load, so that the table is the same whatever --jobs is."""
_ENDS = ("seed", "run", "exit_code", "reason")
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
        ended = {"exit_code": int(self.exit_code), "reason": self.reason}
        return {**self.values, "seed": self.seed, "run": self.run, **ended, **known}


def write_sweep_table(folder: Path, rows: Sequence[SweepRow]) -> None:
    """Write sweep.parquet. Keys are columns of their values' type; lists and mixed types are text.

    Raises CannotWrite.
    """
    keys = {key: _column([row.values[key] for row in rows]) for key in rows[0].values}
    fields = [pa.field(key, kind, nullable=False) for key, (kind, _) in keys.items()]
    fields += [pa.field(name, pa.string() if name in ("run", "reason") else pa.int64(), False) for name in _ENDS]
    fields += [pa.field(name, pa.float64()) for name in SWEEP_METRICS]
    columns: dict[str, Any] = {key: values for key, (_, values) in keys.items()}
    columns |= {name: [getattr(row, name) for row in rows] for name in _ENDS}
    columns |= {name: [row.metrics.get(name, float("nan")) for row in rows] for name in SWEEP_METRICS}
    write_table(folder / TABLE, pa.schema(fields), columns)


def read_sweep_table(folder: Path) -> list[SweepRow]:
    """The rows of sweep.parquet. Raises NotARun where it is missing, damaged or foreign, TooLarge."""
    path = folder / TABLE
    table = read_parquet(path)
    if table.num_rows > _MOST_ROWS:
        raise TooLarge(f"{path}: rows", table.num_rows, _MOST_ROWS)
    names = table.column_names
    if not set(_ENDS) <= set(names) or len(set(names)) < len(names):
        raise NotARun(path, "is no table of a sweep")
    kinds = {"seed": pa.int64(), "exit_code": pa.int64(), "run": pa.string(), "reason": pa.string()}
    keys, metrics = names[: names.index("seed")], [name for name in SWEEP_METRICS if name in names]
    kinds = {key: table.schema.field(key).type for key in keys} | kinds | dict.fromkeys(metrics, pa.float64())
    if wrong := [key for key in keys if kinds[key] not in _KINDS.values()]:
        raise NotARun(path, f"column {wrong[0]} has another type than in a table of a sweep")
    columns = {name: column_to_numpy(path, table, name, kind).tolist() for name, kind in kinds.items()}
    return [
        SweepRow(
            {key: columns[key][at] for key in keys},
            columns["seed"][at],
            columns["run"][at],
            columns["exit_code"][at],
            columns["reason"][at],
            {name: columns[name][at] for name in metrics if np.isfinite(columns[name][at])},
        )
        for at in range(table.num_rows)
    ]


_KINDS = {"bool": pa.bool_(), "int": pa.int64(), "float": pa.float64(), "str": pa.string()}


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


def text_of(value: Any) -> str:
    """A value as a reader sees it: text itself, truth values as TOML has them, all else in Python's short form."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
