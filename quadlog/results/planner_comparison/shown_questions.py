"""Every k-th question of a source with its map and all paths, for the page of a comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.grid import Window
from quadlog.messages import Float
from quadlog.planning.protocol import Bool, Cell, Cells
from quadlog.results.arrays import MOST_CELLS

MOST_QUESTIONS = 1200
MOST_BYTES = 8 << 20
"""Of maps, a bit a cell, and of corners of paths: what a page can hold."""
CORNER_BYTES = 8


@dataclass(frozen=True, slots=True, eq=False)
class ShownMap:
    """A map as bits (layers, rows, ceil(columns / 8)) along x, row = y: the obstacles, then these grown, if they were.

    origin (2,): lower-left corner; cell: edge, in metres or in cells of the file.
    """

    bits: NDArray[np.uint8]
    columns: int
    origin: Float
    cell: float


@dataclass(frozen=True, slots=True, eq=False)
class ShownQuestion:
    """at: episode and replan. start, goal (2,) and the corners of paths (K, 2) lie in the map's frame."""

    at: tuple[int, int]
    map: ShownMap
    start: Float
    goal: Float
    paths: dict[str, Float] = field(default_factory=dict)


class QuestionSample:
    """Keeps every `stride`-th question, a power of 2: the least that keeps no more than a share of the page's room.

    step: what a question is called. row_zero_on_top: rows of the maps count from the top; they are turned. sources: how
    many share the page. asked: number of all questions.
    """

    def __init__(self, step: str = "replan", row_zero_on_top: bool = False, sources: int = 1) -> None:
        self.step, self.stride, self.kept = step, 1, dict[int, ShownQuestion]()
        self.asked = self._bytes = 0
        self.unit = "cells" if row_zero_on_top else "m"
        self._most = MOST_QUESTIONS // sources, MOST_BYTES // sources
        self._last: tuple[Bool, Bool, ShownMap] | None = None

    def add(
        self,
        number: int,
        at: tuple[int, int],
        window: Window,
        layers: tuple[Bool, Bool],
        ends: tuple[Cell, Cell],
        paths: Mapping[str, Cells],
    ) -> None:
        """The number-th question, with cells (L, 2) of the window on each planner's path; again, to add planners.

        layers: occupied and blocked (rows, columns), before and after obstacles were grown; ends: start and goal.
        """
        self.asked = max(self.asked, number + 1)
        if number % self.stride:
            return
        if number not in self.kept:
            start, goal = self._places(window, np.array(ends))
            self.kept[number] = ShownQuestion(at, self._map(window, *layers), start, goal)
        for name, cells in paths.items():
            self.kept[number].paths[name] = corners = self._places(window, _corners(cells))
            self._bytes += CORNER_BYTES * len(corners)
        while len(self.kept) > 1 and (len(self.kept) > self._most[0] or self._bytes > self._most[1]):
            self.stride *= 2
            self.kept = {each: shown for each, shown in self.kept.items() if each % self.stride == 0}
            self._bytes = self._count_bytes()

    def _count_bytes(self) -> int:
        maps = {id(shown.map): shown.map.bits.nbytes for shown in self.kept.values()}
        corners = sum(len(path) for shown in self.kept.values() for path in shown.paths.values())
        return sum(maps.values()) + CORNER_BYTES * corners

    def _map(self, window: Window, occupied: Bool, blocked: Bool) -> ShownMap:
        """The map of a question; the same object while questions are about the same arrays."""
        if self._last is not None and self._last[0] is occupied and self._last[1] is blocked:
            return self._last[2]
        coarse = max(1, math.ceil(math.sqrt(occupied.size / MOST_CELLS)))
        layers = [occupied] if occupied is blocked else [occupied, blocked]
        turned = [layer[::-1] if self.unit == "cells" else layer for layer in layers]
        bits = np.stack([np.packbits(_coarse(layer, coarse), axis=1) for layer in turned])
        shown = ShownMap(bits, -(-occupied.shape[1] // coarse), window.origin_m, window.cell_m * coarse)
        self._last = occupied, blocked, shown
        self._bytes += bits.nbytes
        return shown

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
    if step == 1:
        return layer
    rows, columns = (-(-size // step) for size in layer.shape)
    padded = np.zeros((rows * step, columns * step), dtype=bool)
    padded[: layer.shape[0], : layer.shape[1]] = layer
    return np.asarray(padded.reshape(rows, step, columns, step).any(axis=(1, 3)))
