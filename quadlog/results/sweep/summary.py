"""What the runs of a sweep say together: values over seeds, what differs between settings, and what is best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.comparison.over_seeds import OverSeeds, clear_best, over_seeds
from quadlog.results.sweep.table import SWEEP_METRICS, SweepRow, text_of


@dataclass(frozen=True, slots=True)
class Setting:
    """One combination of values, with its runs by rising seed. label: KEY=VALUE,…"""

    values: Mapping[str, Any]
    rows: Sequence[SweepRow]
    label: str

    @property
    def reason(self) -> str:
        """Why its first failed run failed, or what its first run with losses lost."""
        return next((row.reason for row in self.rows if row.reason), "")


@dataclass(frozen=True, slots=True)
class SweepSummary:
    """varying: metrics that differ between runs; constant: the others, with their value. over: of each metric, by
    setting. best: metric -> setting that is best beyond what seeds explain. seeded: metrics that differ between seeds.
    """

    keys: tuple[str, ...]
    settings: Sequence[Setting]
    seeds: int
    varying: Sequence[str]
    constant: Mapping[str, float]
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
        grouped.setdefault(label_of(row.values), []).append(row)
    settings = [
        Setting(each[0].values, sorted(each, key=lambda row: row.seed), label) for label, each in grouped.items()
    ]
    seeds = sorted({row.seed for row in rows})
    tables = {name: table for name in SWEEP_METRICS if np.isfinite(table := _table(settings, seeds, name)).any()}
    varying = [name for name, table in tables.items() if np.nanmin(table) < np.nanmax(table)]
    seeded = frozenset(name for name in varying if _differs_by_seed(tables[name]))
    best = {}
    for name in seeded:
        better = CATALOGUE[name].better
        found = clear_best(tables[name], lower=better == "lower") if better else None
        if found is not None:
            best[name] = found
    return SweepSummary(
        keys=tuple(rows[0].values) if rows else (),
        settings=settings,
        seeds=len(seeds),
        varying=varying,
        constant={name: float(np.nanmin(table)) for name, table in tables.items() if name not in varying},
        over={name: [over_seeds(values) for values in table] for name, table in tables.items()},
        best=best,
        seeded=seeded,
    )


def label_of(values: Mapping[str, Any]) -> str:
    """KEY=VALUE,…; empty without keys."""
    return ",".join(f"{key}={text_of(value)}" for key, value in values.items())


def _table(settings: Sequence[Setting], seeds: Sequence[int], name: str) -> Float:
    """A metric's values (C, S), NaN where a run has none."""
    table = np.full((len(settings), len(seeds)), np.nan)
    place = {seed: at for at, seed in enumerate(seeds)}
    for at, setting in enumerate(settings):
        for row in setting.rows:
            table[at, place[row.seed]] = row.metrics.get(name, np.nan)
    return table


def _differs_by_seed(table: Float) -> bool:
    return any(len(known) > 1 and np.ptp(known) > 0 for known in (row[np.isfinite(row)] for row in table))
