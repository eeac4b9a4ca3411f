from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

Table = dict[str, np.ndarray]


@pytest.fixture(scope="session")
def make_replans() -> Callable[..., Table]:
    """A replans table from cells (E, R) per planner; every other column by name (E, R) per planner, or a plain one."""

    def make(cells: Mapping[str, Any], source: str = "maze", **others: Mapping[str, Any]) -> Table:
        parts = [_of_planner(name, np.asarray(each), source, others) for name, each in cells.items()]
        return {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}

    return make


def _of_planner(name: str, cells: np.ndarray, source: str, others: Mapping[str, Mapping[str, Any]]) -> Table:
    episodes, replans = cells.shape
    plain = {
        "found": np.ones(cells.shape, dtype=bool),
        "from_scratch": np.ones(cells.shape, dtype=bool),
        "cost": np.full(cells.shape, 100.0),
        "optimal_cost": np.full(cells.shape, 100.0),
        "length_m": np.ones(cells.shape),
        "turn_rad": np.ones(cells.shape),
        "us": np.full(cells.shape, 10.0),
        "generated": 2 * cells,
        "touched": 8 * cells,
    }
    given = {column: np.broadcast_to(each[name], cells.shape) for column, each in others.items() if name in each}
    columns = {column: each.ravel() for column, each in (plain | given).items()}
    return columns | {
        "source": np.full(cells.size, source, dtype=object),
        "planner": np.full(cells.size, name, dtype=object),
        "episode": np.repeat(np.arange(episodes), replans),
        "replan": np.tile(np.arange(replans), episodes),
        "expanded": cells.ravel(),
    }
