"""A comparison of planners: its tables, every format they are printed in, and the questions that its page shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.grid import Window
from quadlog.messages import Float
from quadlog.planning.protocol import Bool, Cells
from quadlog.planning.query import Query
from quadlog.results.arrays import MOST_CELLS
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


MOST_QUESTIONS = 1200
MOST_BYTES = 8 << 20
"""Of maps, a bit a cell: what a page can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownQuestion:
    """A question in the map's frame, whose unit is metres or cells of the file.

    at: episode and replan. bits (layers, rows, ceil(columns / 8)): the map along x, row = y: the obstacles, then these
    grown, if they were; one array for all questions on a map. origin (2,): lower-left corner; cell: edge.
    paths: corners (K, 2) by planner.
    """

    at: tuple[int, int]
    bits: NDArray[np.uint8]
    columns: int
    origin: Float
    cell: float
    start: Float
    goal: Float
    paths: dict[str, Float]


class QuestionSample:
    """Keeps every `stride`-th question, a power of 2: the least that keeps no more than a share of the page's room.

    step: what a question is called. row_zero_on_top: rows of the maps count from the top; they are turned. sources: how
    many share the page. asked: number of all questions.
    """

    def __init__(self, step: str = "replan", row_zero_on_top: bool = False, sources: int = 1) -> None:
        self.step, self.stride, self.kept, self.asked = step, 1, dict[int, ShownQuestion](), 0
        self.unit = "cells" if row_zero_on_top else "m"
        self._sources = sources
        self._last: tuple[tuple[Bool, ...], NDArray[np.uint8]] = ((), np.empty(0, np.uint8))

    def add(self, number: int, at: tuple[int, int], query: Query, occupied: Bool, paths: Mapping[str, Cells]) -> None:
        """The number-th question, with cells (L, 2) of the window on each planner's path; again, to add planners.

        occupied (rows, columns): the map before obstacles were grown.
        """
        self.asked = max(self.asked, number + 1)
        window = query.window
        if number % self.stride == 0 and number not in self.kept:
            coarse = max(1, math.ceil(math.sqrt(occupied.size / MOST_CELLS)))
            start, goal = self._places(window, np.array([query.start, query.goal]))
            bits, columns = self._bits(occupied, query.blocked, coarse), -(-occupied.shape[1] // coarse)
            place = (window.origin_m, window.cell_m * coarse)
            self.kept[number] = ShownQuestion(at, bits, columns, *place, start, goal, {})
            while len(self.kept) > 1 and self._share() > 1 / self._sources:
                self.stride *= 2
                self.kept = {each: shown for each, shown in self.kept.items() if each % self.stride == 0}
        if number in self.kept:
            self.kept[number].paths.update((name, self._places(window, _corners(of))) for name, of in paths.items())

    def _share(self) -> float:
        """The share of the page's room that is taken."""
        maps = {id(shown.bits): shown.bits.nbytes for shown in self.kept.values()}
        return max(len(self.kept) / MOST_QUESTIONS, sum(maps.values()) / MOST_BYTES)

    def _bits(self, occupied: Bool, blocked: Bool, coarse: int) -> NDArray[np.uint8]:
        """The map of a question; the same object while questions are about the same arrays."""
        layers = (occupied,) if occupied is blocked else (occupied, blocked)
        if tuple(map(id, layers)) != tuple(map(id, self._last[0])):
            turned = [layer[::-1] if self.unit == "cells" else layer for layer in layers]
            self._last = layers, np.stack([np.packbits(_coarse(layer, coarse), axis=1) for layer in turned])
        return self._last[1]

    def _places(self, window: Window, cells: NDArray[np.integer]) -> Float:
        places = window.centre_of(cells.reshape(-1, 2))
        if self.unit == "cells":
            places[:, 1] = window.shape[0] - places[:, 1]
        return places


def _corners(cells: Cells) -> Cells:
    """The cells (K, 2) of a path (L, 2) at which it turns, with both ends."""
    if len(cells) < 3:
        return cells
    steps = np.diff(cells, axis=0)
    turns = (steps[1:] != steps[:-1]).any(axis=1)
    return cells[np.array([True, *turns.tolist(), True])]


def _coarse(layer: Bool, step: int) -> Bool:
    """Whether any of step x step cells is true, so that no thin wall is lost."""
    for axis in (0, 1):
        layer = np.logical_or.reduceat(layer, np.arange(0, layer.shape[axis], step), axis=axis)
    return layer
