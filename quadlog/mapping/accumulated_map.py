"""Maps of the whole run: how often each cell was seen occupied or seen through, and how high the ground is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.mapping.compact import CompactScan, slot_transforms
from quadlog.mapping.grid import FARTHEST_CELL, MOST_CELLS, GrowingLattice, Window
from quadlog.mapping.placing import NO_TOP, PlacedScan
from quadlog.mapping.ray_tracing import NO_RAY
from quadlog.messages import Float, Int

UNKNOWN, FREE, OCCUPIED = -1, 0, 100

# A cell is occupied when it was hit in this share of the scans that say anything
# about it. Below one half, because range noise spreads a thin pole's returns
# over several cells, and a missed obstacle costs more than a false one.
OCCUPIED_SHARE = 0.3


class AccumulatedMap:
    """Counts of hits and passes per cell over all scans added, on a lattice that grows with the run.

    skipped: scans that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float) -> None:
        self._lattice = GrowingLattice(cell_m, {"hits": np.int32, "passes": np.int32})
        self.skipped = 0

    def add(self, window: Window, placed: PlacedScan, below_mm: int) -> None:
        """Count one scan: cells (rows, cols) in which something was hit, and cells seen through below this height.

        A cell counts at most once per scan, and as a hit if it is both.
        """
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        hits, row, col = self._lattice.whole("hits", window)
        passes, _, _ = self._lattice.whole("passes", window)
        _count(placed.top_mm, placed.lowest_ray_mm, np.int16(min(below_mm, int(NO_RAY))), hits, passes, row, col)

    def to_cells(self) -> tuple[NDArray[np.int8], Window] | None:
        """Cells (rows, cols) int8, UNKNOWN, FREE or OCCUPIED, and the window they fill; None when no scan was added."""
        window = self._lattice.covered
        if window is None:
            return None
        hits, passes = self._lattice.view("hits", window), self._lattice.view("passes", window)
        cells = np.full(window.shape, UNKNOWN, dtype=np.int8)
        cells[passes > 0] = FREE
        cells[(hits > 0) & (hits >= OCCUPIED_SHARE * (hits + passes))] = OCCUPIED
        return cells, window


@kernel
def _count(
    top_mm: NDArray[np.int16], lowest_ray_mm: NDArray[np.int16], below_mm: int, hits: NDArray[np.int32],
    passes: NDArray[np.int32], first_row: int, first_col: int,
) -> None:  # fmt: skip
    one, none = np.int32(1), np.int32(0)
    rows, cols = top_mm.shape
    for row in range(rows):
        top, ray = top_mm[row], lowest_ray_mm[row]
        hit, passed = hits[first_row + row, first_col:], passes[first_row + row, first_col:]
        for col in range(cols):
            hit[col] += one if top[col] > NO_TOP else none
            passed[col] += one if (ray[col] < below_mm) & (top[col] <= NO_TOP) else none


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Mean height of the ground per cell.

    origin_m: (2,) lower-left corner in map; height_m: (rows, cols) float32,
    NaN where no ground was seen; count: (rows, cols) int32 points per cell.
    """

    origin_m: Float
    cell_m: float
    height_m: NDArray[np.float32]
    count: NDArray[np.int32]


class GroundHeight:
    """Sum and count of ground points' heights per cell, on a lattice that grows with the run.

    skipped: scans that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float) -> None:
        self._cell_m = cell_m
        self._lattice = GrowingLattice(cell_m, {"sum_m": np.float64, "count": np.int32}, MOST_CELLS // 4)
        self._cells, self._bounds = np.zeros((0, 2), np.int64), np.zeros(4, np.int64)
        self.skipped = 0

    def add(self, scan: CompactScan, slot_pose_base_in_map: Float) -> None:
        """Count one scan's ground; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots."""
        n = len(scan.ground)
        if n == 0:
            return
        if n > len(self._cells):
            self._cells = np.zeros((2 * n, 2), np.int64)
        cells, bounds = self._cells, self._bounds
        _cells_of_ground(scan.ground, slot_pose_base_in_map, scan.unit_m, self._cell_m, cells, bounds)
        col0, row0, col1, row1 = (int(bound) for bound in bounds)
        window = Window(col0, row0, self._cell_m, (row1 - row0 + 1, col1 - col0 + 1))
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        sums, row, col = self._lattice.whole("sum_m", window)
        counts, _, _ = self._lattice.whole("count", window)
        _add(scan.ground, cells, col0 - col, row0 - row, sums, counts)

    def to_map(self) -> HeightMap | None:
        """The mean height of every cell seen; None when no ground was."""
        window = self._lattice.covered
        if window is None:
            return None
        count = self._lattice.view("count", window).copy()
        height_m = np.full(window.shape, np.nan, dtype=np.float32)
        seen = count > 0
        height_m[seen] = self._lattice.view("sum_m", window)[seen] / count[seen]
        return HeightMap(window.origin_m, window.cell_m, height_m, count)


@kernel
def _cells_of_ground(
    ground: NDArray[np.void], poses: Float, unit_m: float, cell_m: float, cells: Int, bounds: Int
) -> None:
    """The lattice's cells (col, row) of the ground's means, and their bounds."""
    bounds[0], bounds[1], bounds[2], bounds[3] = FARTHEST_CELL, FARTHEST_CELL, -FARTHEST_CELL, -FARTHEST_CELL
    moved = slot_transforms(poses, unit_m)
    for i in range(len(ground)):
        at, x, y = ground[i]["slot"], ground[i]["x"] + 0.5, ground[i]["y"] + 0.5
        col = np.floor((moved[at, 2] + moved[at, 0] * x - moved[at, 1] * y) / cell_m)
        row = np.floor((moved[at, 3] + moved[at, 1] * x + moved[at, 0] * y) / cell_m)
        cells[i, 0] = np.int64(min(max(col, -FARTHEST_CELL), FARTHEST_CELL))
        cells[i, 1] = np.int64(min(max(row, -FARTHEST_CELL), FARTHEST_CELL))
        bounds[0], bounds[2] = min(bounds[0], cells[i, 0]), max(bounds[2], cells[i, 0])
        bounds[1], bounds[3] = min(bounds[1], cells[i, 1]), max(bounds[3], cells[i, 1])


@kernel
def _add(ground: NDArray[np.void], cells: Int, col0: int, row0: int, sum_m: Float, count: NDArray[np.int32]) -> None:
    for i in range(len(ground)):
        row, col = cells[i, 1] - row0, cells[i, 0] - col0
        sum_m[row, col] += ground[i]["count"] * (ground[i]["z_mm"] * 0.001)
        count[row, col] += ground[i]["count"]
