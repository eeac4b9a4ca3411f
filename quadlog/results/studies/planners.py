"""A comparison of planners: its tables, and every format they are printed in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from quadlog.results.tables import table_schema
from quadlog.results.text import TitledTable, ends_text, print_table, print_tables, terminal_width

REPLANS = table_schema(
    "source:text episode:int replan:int t_ns:int planner:text found:bool why_not:text expanded:int generated:int "
    "touched:int cost optimal_cost from_scratch:bool reused_cells:int start_col:int start_row:int goal_col:int "
    "goal_row:int goal_projected:bool length_m turn_rad curvature_max_1pm us"
)
"""One row per planner and replan; cells are those of the lattice, costs in the units of --costs."""

PLANNERS = table_schema(
    "source:text planner:text episodes:int replans:int success_rate expanded_total:int generated_total:int "
    "touched_total:int expanded_mean ratio_expanded ratio_low ratio_high suboptimality_mean suboptimality_p95 "
    "fallback_share us_median us_p95 length_m_total turn_rad_total"
)
"""One row per planner and source."""

SCENARIOS = table_schema(
    "map:text planner:text start_col:int start_row:int goal_col:int goal_row:int listed_cost cost expanded:int us "
    "found:bool"
)
"""One row per query of a .scen file and planner; costs in cells, straight 1, diagonal √2."""


Row = Mapping[str, Any]
"""The columns of planners.parquet with plain values; None where there is none."""
_HEADER = ("planner", "found %", "cells", "ratio", "95 %", "excess %", "time us", "p95 us")
_KEY = (
    "cells: expanded per replan; ratio: cells of the baseline / cells of this planner, above 1 is better; excess: of "
    "the path's cost over the optimal one; all columns: --format csv"
)


def format_rows(rows: Sequence[Row], to: str, notes: Sequence[str] = ()) -> str:
    """The rows of any number of sources as the format `to`, with a line end.

    json and csv have all columns in full precision. notes: sentences on how to read the figures; left out there.
    """
    if to in ("json", "csv"):
        return print_table(PLANNERS.names, [[row[name] for name in PLANNERS.names] for row in rows], to)
    tables: dict[str, list[list[Any]]] = {}
    for row in rows:
        ends, excess = (row["ratio_low"], row["ratio_high"]), row["suboptimality_mean"]
        cells = [row["planner"], 100 * row["success_rate"], row["expanded_mean"], row["ratio_expanded"]]
        cells += ["" if None in ends else ends_text(ends), None if excess is None else 100 * excess]
        counts = (f"{row[name]} {name if row[name] != 1 else name[:-1]}" for name in ("episodes", "replans"))
        title = f"{row['source']}: {', '.join(counts)}"
        tables.setdefault(title, []).append([*cells, row["us_median"], row["us_p95"]])
    titled = [TitledTable(title, _HEADER, lines) for title, lines in tables.items()]
    return print_tables(titled, to, [_KEY, *notes], terminal_width())
