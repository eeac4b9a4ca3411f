"""Greedy best-first search: always on from the open cell that looks nearest to the goal. Quick, and often a detour."""

from __future__ import annotations

import heapq
from typing import ClassVar

import numpy as np

from quadlog.planning.protocol import Bool, Cell, Plan, is_usable, no_plan
from quadlog.planning.rules import USUAL, Rules

STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1))


class Greedy:
    """See quadlog.planning.protocol.Planner. It remembers nothing from one plan to the next."""

    name: ClassVar[str] = "greedy"
    incremental: ClassVar[bool] = False

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = rules

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """A path from start to goal, cells as (col, row) where blocked (rows, cols) is free; where there is one."""
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return no_plan()
        parents: dict[Cell, Cell] = {start: start}
        waiting = [(distance(start, goal), start)]
        expanded = touched = 0
        while waiting:
            _, cell = heapq.heappop(waiting)
            expanded += 1
            if cell == goal:
                break
            for dcol, drow in STEPS:
                touched += 1
                neighbour = (cell[0] + dcol, cell[1] + drow)
                if neighbour not in parents and self._may_step(blocked, cell, neighbour):
                    parents[neighbour] = cell
                    heapq.heappush(waiting, (distance(neighbour, goal), neighbour))
        if goal not in parents:
            return no_plan(expanded, len(parents), touched)
        return self._plan(path(parents, goal), expanded, len(parents), touched)

    def reset(self) -> None:
        """Nothing to forget."""

    def _may_step(self, blocked: Bool, cell: Cell, neighbour: Cell) -> bool:
        """Into a free cell; diagonally only between two free ones, unless corners may be cut."""
        if not is_usable(blocked, neighbour):
            return False
        corner = blocked[cell[1], neighbour[0]] or blocked[neighbour[1], cell[0]]
        return self.rules.corner_cutting or not corner

    def _plan(self, cells: list[Cell], expanded: int, generated: int, touched: int) -> Plan:
        steps = np.diff(cells, axis=0).reshape(-1, 2)
        diagonals = int(np.count_nonzero(steps.all(axis=1)))
        return Plan(
            found=True,
            cells=np.array(cells, dtype=np.int32),
            cost=self.rules.cost_of(len(steps) - diagonals, diagonals),
            expanded=expanded,
            generated=generated,
            touched=touched,
            from_scratch=True,
            reused_cells=0,
        )


def distance(cell: Cell, goal: Cell) -> int:
    """Steps to the goal over free cells."""
    return max(abs(cell[0] - goal[0]), abs(cell[1] - goal[1]))


def path(parents: dict[Cell, Cell], goal: Cell) -> list[Cell]:
    """From start to goal."""
    cells = [goal]
    while parents[cells[-1]] != cells[-1]:
        cells.append(parents[cells[-1]])
    return cells[::-1]
