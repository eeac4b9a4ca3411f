"""The tables of `quadlog compare-planners`: columns in order, with their types; null only where a float is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from quadlog.results.tables import TableWriter

_INT, _FLOAT, _BOOL, _TEXT = pa.int64(), pa.float64(), pa.bool_(), pa.string()


def _schema(**columns: pa.DataType) -> pa.Schema:
    return pa.schema([pa.field(name, kind, nullable=kind == _FLOAT) for name, kind in columns.items()])


REPLANS = _schema(
    source=_TEXT,
    **dict.fromkeys(("episode", "replan", "t_ns"), _INT),
    planner=_TEXT,
    found=_BOOL,
    why_not=_TEXT,
    **dict.fromkeys(("expanded", "generated", "touched"), _INT),
    **dict.fromkeys(("cost", "optimal_cost"), _FLOAT),
    from_scratch=_BOOL,
    **dict.fromkeys(("reused_cells", "start_col", "start_row", "goal_col", "goal_row"), _INT),
    goal_projected=_BOOL,
    **dict.fromkeys(("length_m", "turn_rad", "curvature_max_1pm", "us"), _FLOAT),
)
"""One row per planner and replan; cells are those of the lattice, costs in the units of --costs."""

PLANNERS = _schema(
    source=_TEXT,
    planner=_TEXT,
    episodes=_INT,
    replans=_INT,
    success_rate=_FLOAT,
    **dict.fromkeys(("expanded_total", "generated_total", "touched_total"), _INT),
    **dict.fromkeys(("expanded_mean", "ratio_expanded", "ratio_low", "ratio_high"), _FLOAT),
    **dict.fromkeys(("suboptimality_mean", "suboptimality_p95", "fallback_share", "us_median", "us_p95"), _FLOAT),
    **dict.fromkeys(("length_m_total", "turn_rad_total"), _FLOAT),
)
"""One row per planner and source."""

SCENARIOS = _schema(
    map=_TEXT,
    planner=_TEXT,
    **dict.fromkeys(("start_col", "start_row", "goal_col", "goal_row"), _INT),
    **dict.fromkeys(("listed_cost", "cost"), _FLOAT),
    expanded=_INT,
    us=_FLOAT,
    found=_BOOL,
)
"""One row per query of a .scen file and planner; costs in cells, straight 1, diagonal √2."""

COMPARISON_TABLES = {"replans": REPLANS, "planners": PLANNERS, "scenarios": SCENARIOS}


def write_planners(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """planners.parquet from its rows, each with every column; None is no value. Raises CannotWrite."""
    with TableWriter(path, PLANNERS) as table:
        for row in rows:
            table.add_row(row)
