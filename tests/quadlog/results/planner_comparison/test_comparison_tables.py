"""The contract's columns of compare-planners, written out by hand: these names never change."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from quadlog.results.planner_comparison.tables import PLANNERS, REPLANS, SCENARIOS, write_planners

CONTRACT = {
    "replans": "source episode replan t_ns planner found why_not expanded generated touched cost optimal_cost "
    "from_scratch reused_cells start_col start_row goal_col goal_row goal_projected length_m turn_rad "
    "curvature_max_1pm us",
    "planners": "source planner episodes replans success_rate expanded_total generated_total touched_total "
    "expanded_mean ratio_expanded ratio_low ratio_high suboptimality_mean suboptimality_p95 fallback_share us_median "
    "us_p95 length_m_total turn_rad_total",
    "scenarios": "map planner start_col start_row goal_col goal_row listed_cost cost expanded us found",
}
SCHEMAS = {"replans": REPLANS, "planners": PLANNERS, "scenarios": SCENARIOS}
TEXTS = {"source", "planner", "why_not", "map"}
FLAGS = {"found", "from_scratch", "goal_projected"}
INTEGERS = {"episode", "episodes", "replan", "replans", "t_ns", "expanded", "generated", "touched", "reused_cells"}
INTEGERS |= {"start_col", "start_row", "goal_col", "goal_row", "expanded_total", "generated_total", "touched_total"}


@pytest.mark.parametrize("name", CONTRACT)
def test_columns_and_types_are_the_contracts(name: str) -> None:
    schema = SCHEMAS[name]
    assert schema.names == CONTRACT[name].split()
    for field in schema:
        kind = pa.string() if field.name in TEXTS else pa.bool_() if field.name in FLAGS else pa.float64()
        kind = pa.int64() if field.name in INTEGERS else kind
        assert (field.type, field.nullable) == (kind, kind == pa.float64()), field


def test_rows_come_back_and_what_does_not_exist_is_null(tmp_path: Path) -> None:
    texts = {"source": "forest:0.2", "planner": "astar"}
    row = {name: texts.get(name, 3 if name in INTEGERS else 0.5) for name in PLANNERS.names}
    rows = [row | {"fallback_share": None}, row | {"planner": "ia_star", "ratio_low": None, "fallback_share": None}]
    write_planners(tmp_path / "planners.parquet", rows)
    assert pq.read_table(tmp_path / "planners.parquet").to_pylist() == rows
