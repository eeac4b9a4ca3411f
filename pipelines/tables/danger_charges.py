"""Rows of the table planning-ea on what rings of danger can do at all: leave passages open, and telescope."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import bellman_ford

from quadlog.mapping.inflation import inflate_square
from quadlog.pipelines.tables.kept_clearance import FORMS, RINGS, clearance_cells, ends_of
from quadlog.planning.danger import danger_levels
from quadlog.planning.ea_star import LEVEL_CHARGE, SAME_LEVEL
from quadlog.planning.polyline import turning
from quadlog.planning.protocol import Bool, Cell, Cells
from quadlog.planning.registry import make_planner
from quadlog.planning.steps import FIRST_DIAGONAL, STEP_COL, STEP_COST, STEP_ROW
from quadlog.results.paper_rows import PaperRow, RowGroup
from quadlog.simulation.planning_scenes import SCENES
from quadlog.simulation.planning_worlds import CELL_M

PASSAGE_CELLS = 15
NARROWED_BY = (0, 3, 5, 6)
"""Cells of growth that leave 15, 9, 5 and 3 cells of the passage open."""
GROWN = "obstacles grown by n cells, astar"


def passage_group() -> RowGroup:
    """How narrow a passage may be, for rings and for obstacles that are grown by as much."""
    rows = [
        PaperRow(f"narrowest passage left open, n = {n}, {name} (cells)", float(narrowest(name, n)))
        for name in (*FORMS, GROWN)
        for n in RINGS
    ]
    widths = ", ".join(str(PASSAGE_CELLS - 2 * growth) for growth in NARROWED_BY)
    text = (
        f"The passage of 1.5 m, {PASSAGE_CELLS} cells, narrowed so that {widths} cells are left; there is no other "
        "way. Rings make a way dear and block none, not even of 3 cells, the narrowest tried. Obstacles that "
        "are grown by n cells instead close it."
    )
    return RowGroup("Fig. 20: the passage", text, tuple(rows))


def narrowest(name: str, rings: int) -> int:
    """The narrowest of the passages, in cells, through which one of FORMS with so many rings, or GROWN, has a way."""
    world = SCENES["passage"]()
    left_open = []
    for growth in NARROWED_BY:
        blocked = inflate_square(world.occupied, growth + (rings if name == GROWN else 0))
        planner = make_planner("astar") if name == GROWN else FORMS[name](rings=rings)
        if planner.plan(blocked, *ends_of(world)).found:
            left_open.append(PASSAGE_CELLS - 2 * growth)
    return min(left_open)


def telescoping_group() -> RowGroup:
    """The printed charges without the printed search: the cheapest way there is."""
    world = SCENES["single-obstacle"]()
    plain = make_planner("astar").plan(world.occupied, *ends_of(world)).cells
    paths = {"astar": plain}
    paths |= {f"cheapest way, n = {n}": cheapest_path(world.occupied, n, *ends_of(world)) for n in RINGS}
    measures: dict[str, Callable[[Cells], float]] = {
        "length (m)": lambda cells: round(turning(cells * CELL_M)[0], 9),
        "clearance (cells)": lambda cells: float(clearance_cells(world.occupied, cells)),
    }
    rows = [
        PaperRow(f"{name}: {measure}", of(cells)) for name, cells in paths.items() for measure, of in measures.items()
    ]
    text = (
        "The square again, with every step charged as eq. 13 prints it. But the cheapest way of all is looked for, by "
        "the algorithm of Bellman and Ford, which closes nothing."
    )
    return RowGroup("Eq. 13: what the charges are worth", text, tuple(rows))


def cheapest_path(occupied: Bool, rings: int, start: Cell, goal: Cell) -> Cells:
    """The path (L, 2) of least steps and printed charges, from start to goal (col, row)."""
    rows, cols = occupied.shape
    from_cell, to_cell, cost = _charged_steps(occupied, rings)
    graph = coo_array((cost, (from_cell, to_cell)), shape=(rows * cols, rows * cols)).tocsr()
    first, last = (row * cols + col for col, row in (start, goal))
    _, before = bellman_ford(graph, indices=first, return_predecessors=True)
    way = [last]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return np.array([(cell % cols, cell // cols) for cell in reversed(way)], dtype=np.int32)


def _charged_steps(occupied: Bool, rings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(from, to, cost) of every legal step between flat cells [Planning, eq. 13]."""
    walled = np.pad(occupied, 1, constant_values=True)
    levels = np.pad(danger_levels(occupied, rings).astype(np.int64), 1)
    row, col = np.nonzero(~walled)
    steps = []
    for k in range(8):
        to_row, to_col = row + STEP_ROW[k], col + STEP_COL[k]
        free = ~walled[to_row, to_col]
        if k >= FIRST_DIAGONAL:
            free &= ~walled[row, to_col] & ~walled[to_row, col]
        at, to = (row[free], col[free]), (to_row[free], to_col[free])
        rise = levels[to] - levels[at]
        # Thousandths of a straight step, in tenths.
        cost = STEP_COST[k] + (LEVEL_CHARGE * rise - SAME_LEVEL * (rise == 0)) / 100
        flat = [(each_row - 1) * occupied.shape[1] + each_col - 1 for each_row, each_col in (at, to)]
        steps.append((*flat, cost))
    from_cell, to_cell, cost = (np.concatenate(parts) for parts in zip(*steps, strict=True))
    return from_cell, to_cell, cost
