"""A study: seeded walks at many points, on any executor; a row of a DataFrame for each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import product
from typing import Any

import pandas as pd

Point = dict[str, Any]
Figures = Mapping[str, float]

HELD_OUT_SEED = 2000
"""Seeds that are reported start here; whatever was chosen, was chosen on smaller ones."""
SEEDS_PER_TABLE = 100


def held_out_seeds(count: int, seed: int) -> range:
    """The walks' seeds of a table's seed; those of two tables' seeds have none in common."""
    assert count <= SEEDS_PER_TABLE
    first = HELD_OUT_SEED + SEEDS_PER_TABLE * seed
    return range(first, first + count)


def grid(**factors: Iterable[Any]) -> list[Point]:
    """Every combination of the factors' values."""
    return [dict(zip(factors, values, strict=True)) for values in product(*factors.values())]


@dataclass(frozen=True)
class Study:
    """measure(**point) walks once and returns its figures by name; one that does not apply is absent."""

    measure: Callable[..., Figures]
    points: Sequence[Point]

    def submit(self, executor: Executor) -> list[Future[Figures]]:
        """A task for each point."""
        return [executor.submit(self.measure, **point) for point in self.points]

    def records(self, figures: Iterable[Figures]) -> list[Point]:
        """Points and figures side by side, plain numbers all; a figure that is not finite is left out."""
        return [
            point | {name: float(value) for name, value in found.items() if math.isfinite(value)}
            for point, found in zip(self.points, figures, strict=True)
        ]


def select(walks: pd.DataFrame, where: Mapping[str, Any]) -> pd.DataFrame:
    """The walks whose factors have these values; None stands for a factor that is not given."""
    wanted = pd.Series(True, index=walks.index)
    for name, value in where.items():
        wanted &= walks[name].isna() if value is None else walks[name] == value
    return walks[wanted]
