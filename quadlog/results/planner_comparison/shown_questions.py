"""A bounded sample of the questions of a comparison, with their maps and all paths, for the page."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.grid import Window
from quadlog.messages import Int
from quadlog.planning.protocol import Bool, Cell, Cells

MAX_QUESTIONS = 1200
MAX_PATH_POINTS = 200_000
"""Of all paths together, after the cells on straight stretches are left out."""
MAX_MAP_BYTES, MAX_DEFLATED_BYTES = 16 << 20, 2 << 20
"""Of all maps together, obstacles and growth: a bit a cell in memory, and deflated, each by its difference from the one
before, about as the page holds them."""
_LIMITS = (MAX_QUESTIONS, MAX_PATH_POINTS, MAX_MAP_BYTES, MAX_DEFLATED_BYTES)
MAX_MAP_CELLS = 4_000_000
"""Of one map of a static source; larger ones are shown with coarser cells."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownMap:
    """A map as bits: obstacles and, where they grow, grown, each packed by numpy.packbits along x.

    col0, row0: lattice cell of its lower-left corner; column and row of a cell are taken modulo the map's size.
    """

    col0: int
    row0: int
    obstacles: bytes
    grown: bytes

    @property
    def bits(self) -> NDArray[np.uint8]:
        """Both layers, one after the other."""
        return np.frombuffer(self.obstacles + (self.grown or self.obstacles), np.uint8)


@dataclass(frozen=True, slots=True)
class ShownQuestion:
    """One question with every answer. start, goal and points of paths: (col, row) in cells of the lattice, row = y.

    paths: the corners (K, 2) of each planner's path, none where it found no path.
    """

    episode: int
    replan: int
    map: ShownMap
    start: Cell
    goal: Cell
    paths: dict[str, Cells] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ShownQuestions:
    """The sample of one source, in the order of the questions.

    shape: (rows, cols) of every map; cell: edge of a cell in `unit`; step: cells of the source along one of the map's.
    is_static: questions stand alone. stride: 1 where every question of these episodes is here, else every stride-th
    one of the first episode, or of a static source. sources: how many share the page.
    """

    questions: tuple[ShownQuestion, ...]
    shape: tuple[int, int]
    cell: float
    unit: str
    step: int
    is_static: bool
    stride: int
    sources: int


class QuestionSample:
    """Keeps questions while a comparison runs: whole episodes while there is room, or every stride-th question.

    Of a walk the first episode is always there, with a stride where it is too long. Of a static source, whose questions
    stand alone and may come once for each planner, questions are spread evenly. What is kept depends on the order of
    questions alone. sources: how many share the page.
    """

    def __init__(self, is_static: bool, row_zero_on_top: bool, sources: int = 1) -> None:
        self._is_static, self._flipped, self._sources = is_static, row_zero_on_top, sources
        self._most = tuple(limit // sources for limit in _LIMITS)
        self._kept: dict[tuple[int, int], ShownQuestion] = {}
        self._stride, self._past_last = 1, math.inf
        self._latest = (-1, -1)
        self._points = self._map_bytes = self._deflated_bytes = 0
        self._window: Window | None = None
        self._map: tuple[Window, Bool, Bool, ShownMap] | None = None

    def add(
        self,
        at: tuple[int, int],
        window: Window,
        layers: tuple[Bool, Bool],
        ends: tuple[Cell, Cell],
        cells: Mapping[str, Cells],
    ) -> None:
        """The question `at` (episode, replan) with cells (L, 2) of the window of each planner's path.

        layers: occupied and blocked (rows, cols), before and after obstacles were grown; ends: start and goal.
        Later calls for the same question add planners.
        """
        known = self._kept.get(at)
        if known is None:
            if not self._has_room_for(at):
                return
            self._window = self._window or window
            start, goal = (self._on_lattice(window, np.array([end]))[0] for end in ends)
            known = ShownQuestion(*at, self._map_of(window, *layers), _cell(start), _cell(goal))
            self._kept[at], self._latest = known, at
        for name, path in cells.items():
            known.paths[name] = self._on_lattice(window, _corners(path))
            self._points += len(known.paths[name])
        while self._is_full() and len(self._kept) > 1:
            self._thin(at[0])

    def finish(self) -> ShownQuestions | None:
        """The sample; None where there was no question that could be asked."""
        if self._window is None or not self._kept:
            return None
        step, (rows, cols) = self._step(self._window), self._window.shape
        shape = (math.ceil(rows / step), math.ceil(cols / step))
        return ShownQuestions(
            tuple(self._kept.values()),
            shape,
            self._window.cell_m,
            "cells" if self._flipped else "m",
            step,
            self._is_static,
            self._stride,
            self._sources,
        )

    def _has_room_for(self, at: tuple[int, int]) -> bool:
        episode, replan = at
        if self._is_static:
            return episode % self._stride == 0 and at > self._latest
        return episode < self._past_last and (self._stride == 1 or episode == 0) and replan % self._stride == 0

    def _is_full(self) -> bool:
        held = len(self._kept), self._points, self._map_bytes, self._deflated_bytes
        return any(amount > limit for amount, limit in zip(held, self._most, strict=True))

    def _thin(self, episode: int) -> None:
        """Leave out the last episode, or of the only one, or of a static source, every other question."""
        if not self._is_static and episode > 0:
            self._past_last = episode
            self._kept = {at: each for at, each in self._kept.items() if at[0] < episode}
        else:
            self._stride *= 2
            place = 0 if self._is_static else 1
            self._kept = {at: each for at, each in self._kept.items() if at[place] % self._stride == 0}
        self._points = sum(len(path) for each in self._kept.values() for path in each.paths.values())
        self._map_bytes = self._deflated_bytes = 0
        before = None
        for each in dict.fromkeys(question.map for question in self._kept.values()):
            self._count(before, each)
            before = each

    def _map_of(self, window: Window, occupied: Bool, blocked: Bool) -> ShownMap:
        """The map of a question; the same object where it is the map of the question before."""
        if self._map is not None:
            before, *layers, shown = self._map
            same = all(a is b or np.array_equal(a, b) for a, b in zip(layers, (occupied, blocked), strict=True))
            if before == window and same:
                return shown
        packed = [self._packed(window, layer) for layer in (occupied, blocked)]
        shown = ShownMap(window.col0, window.row0, packed[0], packed[1] if packed[0] != packed[1] else b"")
        self._count(None if self._map is None else self._map[-1], shown)
        self._map = (window, occupied, blocked, shown)
        return shown

    def _count(self, before: ShownMap | None, shown: ShownMap) -> None:
        bits = shown.bits
        changed = bits if before is None else bits ^ before.bits
        self._map_bytes += len(bits)
        self._deflated_bytes += len(zlib.compress(changed.tobytes(), 1))

    def _packed(self, window: Window, layer: Bool) -> bytes:
        if self._is_static:
            coarse = _coarse(layer[::-1] if self._flipped else layer, self._step(window))
            return np.packbits(coarse, axis=1).tobytes()
        shift = (window.row0 % window.shape[0], window.col0 % window.shape[1])
        return np.packbits(np.roll(layer, shift, axis=(0, 1)), axis=1).tobytes()

    def _step(self, window: Window) -> int:
        cells = window.shape[0] * window.shape[1]
        return max(1, math.ceil(math.sqrt(cells / MAX_MAP_CELLS))) if self._is_static else 1

    def _on_lattice(self, window: Window, cells: Cells | Int) -> Cells:
        """(K, 2) cells of the window, on the lattice; upside down where the map's row 0 is the upper one."""
        lattice = np.asarray(cells, dtype=np.int64).reshape(-1, 2) + np.array([window.col0, window.row0])
        if self._flipped:
            lattice[:, 1] = window.shape[0] - 1 - lattice[:, 1]
        return lattice.astype(np.int32)


def _cell(pair: Cells) -> Cell:
    return int(pair[0]), int(pair[1])


def _corners(cells: Cells) -> Cells:
    """The cells (K, 2) of a path (L, 2) at which it turns, with both ends."""
    if len(cells) < 3:
        return cells
    steps = np.diff(cells, axis=0)
    turns = (steps[1:] != steps[:-1]).any(axis=1)
    return cells[np.array([True, *turns.tolist(), True])]


def _coarse(layer: Bool, step: int) -> NDArray[np.bool_]:
    """Whether any of step x step cells is true, so that no thin wall is lost."""
    if step == 1:
        return layer
    rows, cols = (math.ceil(size / step) for size in layer.shape)
    padded = np.zeros((rows * step, cols * step), dtype=bool)
    padded[: layer.shape[0], : layer.shape[1]] = layer
    return np.asarray(padded.reshape(rows, step, cols, step).any(axis=(1, 3)))
