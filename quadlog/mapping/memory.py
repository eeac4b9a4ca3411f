"""What maps keep of scans: log odds cleared by rays that pass through; and maps of the whole run: how often each cell
was seen occupied or seen through, and how high the ground is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from quadlog.compiled import kernel
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass, Returns
from quadlog.mapping.grid import FARTHEST_CELL, MOST_CELLS, Grid, GrowingLattice, Window
from quadlog.mapping.placing import NO_TOP, PlacedScan, slot_transforms
from quadlog.messages import Float, Float32, Int

Int16 = NDArray[np.int16]

_GROUND = np.uint8(PointClass.GROUND)
_HIT_MS = np.int16(200)
"""A cell that was hit once survives this much contradicting sight; a false point is gone after two scans at 10 Hz."""
LONGEST_STEP_S = 0.2
"""Longest time between scans that counts as contradicting sight."""
_LONGEST_MS = 32000
_SAME_HEIGHT_MM = np.int16(1)
# An obstacle higher by this than the cell's top is stored as a second one above it.
_STACKED_MM = np.int16(150)


class LogOddsMemory:
    """A cell stays occupied until rays have crossed it below the top of what stood there for long enough.

    Log odds with a floor at "free" and a ceiling, in milliseconds of contradicting sight: a hit adds _HIT_MS up to
    clear_s, a scan that sees through takes the time since the scan before. So what is out of sight stays, and what has
    moved away is gone clear_s after it was seen to be, at any scan rate. A ray that passes above a low obstacle does
    not contradict it; one that passes where it was hit does, or a scan in a plane would never clear.
    A cell holds two things, one above the other, each with its own evidence: what was seen twice and is
    then overtopped, as a crate by a person who steps over it, outlasts what has been above it. The height of the lower
    one falls to that of the rays that pass above it while it is hit.
    Scans that the lattice skips, for want of room, are maps of that scan alone.
    """

    LAYERS: ClassVar[dict[str, DTypeLike]] = dict.fromkeys(("low_ms", "low_mm", "high_ms", "high_mm"), np.int16)

    def __init__(self, lattice: GrowingLattice, clear_s: float) -> None:
        self.lattice, self._clear_ms = lattice, np.int16(min(max(round(clear_s * 1e3), 1), _LONGEST_MS))
        self._last_ns: int | None = None

    def add(self, t_ns: int, window: Window, placed: PlacedScan) -> Grid:
        """The cells hit now, and those hit before that nothing contradicts."""
        if not self.lattice.cover(window):
            return placed.top_mm > NO_TOP
        passed_s = 0.0 if self._last_ns is None else min(max((t_ns - self._last_ns) * 1e-9, 0.0), LONGEST_STEP_S)
        self._last_ns = t_ns
        occupied: Grid = np.empty(window.shape, np.bool_)
        low_ms, row, col = self.lattice.whole("low_ms", window)
        others = [self.lattice.whole(name, window)[0] for name in ("low_mm", "high_ms", "high_mm")]
        _remember(*placed, low_ms, *others, row, col, np.int16(round(passed_s * 1e3)), self._clear_ms, occupied)
        return occupied


@kernel
def _remember(
    top_mm: Int16, lowest_ray_mm: Int16, low_ms: Int16, low_mm: Int16, high_ms: Int16, high_mm: Int16,
    first_row: int, first_col: int, passed_ms: int, clear_ms: int, occupied: Grid,
) -> None:  # fmt: skip
    none, settled = np.int16(0), min(np.int16(2 * _HIT_MS), clear_ms)
    rows, cols = top_mm.shape
    for row in range(rows):
        tops, rays, here = top_mm[row], lowest_ray_mm[row], occupied[row]
        low, low_top = low_ms[first_row + row, first_col:], low_mm[first_row + row, first_col:]
        high, high_top = high_ms[first_row + row, first_col:], high_mm[first_row + row, first_col:]
        for col in range(cols):
            top, ray = tops[col], rays[col]
            lasting, lasting_top, upper, upper_top = low[col], low_top[col], high[col], high_top[col]
            hit = top > NO_TOP
            over = hit & (lasting >= settled) & (top > np.int16(lasting_top + _STACKED_MM))
            # What rays cross above the hit is not there any more.
            lower = lasting_top if lasting_top < ray else ray
            left = lower if lasting > none else top
            seen_under = ray <= np.int16(lasting_top + _SAME_HEIGHT_MM)
            less = np.int16(lasting - passed_ms) if seen_under & (lasting > none) & (not hit) else lasting
            kept_top = left if left > top else top
            lasting_top = kept_top if hit & (not over) else lasting_top
            more = np.int16(lasting + _HIT_MS) if lasting < clear_ms - _HIT_MS else clear_ms
            lasting = more if hit & (not over) else less
            seen_through = (upper > none) & (ray <= np.int16(upper_top + _SAME_HEIGHT_MM))
            less = np.int16(upper - passed_ms) if seen_through else upper
            highest = upper_top if (upper > none) & (upper_top > top) else top
            upper_top = highest if over else upper_top
            more = np.int16(upper + _HIT_MS) if upper < clear_ms - _HIT_MS else clear_ms
            upper = more if over else less
            lasts, rests = lasting > none, upper > none
            low[col] = lasting if lasts else (upper if rests else none)
            low_top[col] = lasting_top if lasts else (upper_top if rests else none)
            high[col] = upper if lasts & rests else none
            high_top[col] = upper_top if lasts & rests else none
            here[col] = lasts | rests


UNKNOWN, FREE, OCCUPIED = -1, 0, 100

# A cell is occupied when it was hit in this share of the scans that say anything
# about it. Below one half, because range noise spreads a thin pole's returns
# over several cells, and a missed obstacle costs more than a false one.
OCCUPIED_SHARE = 0.3


class AccumulatedMap:
    """Counts of hits and passes per cell over all scans added, on a lattice that grows with the run.

    lattice.skipped: scans that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float) -> None:
        self.lattice = GrowingLattice(cell_m, {"hits": np.int32, "passes": np.int32})

    def add(self, window: Window, placed: PlacedScan, below_mm: int) -> None:
        """Count one scan: cells (rows, cols) in which something was hit, and cells seen through below this height.

        A cell counts at most once per scan, and as a hit if it is both.
        """
        if not self.lattice.cover(window):
            return
        hits, passes = (self.lattice.view(name, window) for name in ("hits", "passes"))
        hit = placed.top_mm > NO_TOP
        hits += hit
        passes += (placed.lowest_ray_mm < below_mm) & ~hit

    def to_cells(self) -> tuple[NDArray[np.int8], Window] | None:
        """Cells (rows, cols) int8, UNKNOWN, FREE or OCCUPIED, and the window they fill; None when no scan was added."""
        window = self.lattice.covered
        if window is None:
            return None
        hits, passes = self.lattice.view("hits", window), self.lattice.view("passes", window)
        cells = np.full(window.shape, UNKNOWN, dtype=np.int8)
        cells[passes > 0] = FREE
        cells[(hits > 0) & (hits >= OCCUPIED_SHARE * (hits + passes))] = OCCUPIED
        return cells, window


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

    lattice.skipped: scans that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float) -> None:
        self._cell_m = cell_m
        self.lattice = GrowingLattice(cell_m, {"sum_m": np.float64, "count": np.int32}, MOST_CELLS // 4)
        self._cells, self._bounds = np.zeros((0, 3), np.int64), np.zeros(4, np.int64)

    def add(self, scan: ClassifiedScan, slot_pose_base_in_map: Float, reach_m: float) -> None:
        """Count one scan's ground up to reach_m from the lidar; slot_pose_base_in_map: (K, 3) at its time slots."""
        found, cells, bounds = scan.returns, self._cells, self._bounds
        if len(found.label) > len(cells):
            self._cells = cells = np.zeros((len(found.label), 3), np.int64)
        place = np.array([*scan.lidar_base_m[:2], self._cell_m, reach_m])
        cells = cells[: _cells_of_ground(found, place, slot_pose_base_in_map, cells, bounds)]
        if len(cells) == 0:
            return
        col0, row0, col1, row1 = (int(bound) for bound in bounds)
        window = Window(col0, row0, self._cell_m, (row1 - row0 + 1, col1 - col0 + 1))
        if not self.lattice.cover(window):
            return
        sums, row, col = self.lattice.whole("sum_m", window)
        counts, _, _ = self.lattice.whole("count", window)
        _add(found.z_m, cells, col0 - col, row0 - row, sums, counts)

    def to_map(self) -> HeightMap | None:
        """The mean height of every cell seen; None when no ground was."""
        window = self.lattice.covered
        if window is None:
            return None
        count = self.lattice.view("count", window).copy()
        height_m = np.full(window.shape, np.nan, dtype=np.float32)
        seen = count > 0
        height_m[seen] = self.lattice.view("sum_m", window)[seen] / count[seen]
        return HeightMap(window.origin_m, window.cell_m, height_m, count)


@kernel
def _cells_of_ground(returns: Returns, place: Float, poses: Float, cells: Int, bounds: Int) -> int:
    """The lattice's cells (col, row) of ground points and the points' numbers, how many, and the cells' bounds.

    place: the lidar's x and y in base, the edge of a cell, and the reach.
    """
    bounds[0], bounds[1], bounds[2], bounds[3] = FARTHEST_CELL, FARTHEST_CELL, -FARTHEST_CELL, -FARTHEST_CELL
    moved, found, farthest = slot_transforms(poses), 0, place[3] * place[3]
    for i in range(len(returns.label)):
        if returns.label[i] != _GROUND:
            continue
        dx, dy, at = np.float64(returns.dx_m[i]), np.float64(returns.dy_m[i]), returns.slot[i]
        # NaN fails this comparison as well.
        if not dx * dx + dy * dy <= farthest:
            continue
        x, y = dx + place[0], dy + place[1]
        col = np.floor((moved[at, 2] + moved[at, 0] * x - moved[at, 1] * y) / place[2])
        row = np.floor((moved[at, 3] + moved[at, 1] * x + moved[at, 0] * y) / place[2])
        cell = cells[found]
        cell[0] = np.int64(min(max(col, -FARTHEST_CELL), FARTHEST_CELL))
        cell[1] = np.int64(min(max(row, -FARTHEST_CELL), FARTHEST_CELL))
        cell[2] = i
        bounds[0], bounds[2] = min(bounds[0], cell[0]), max(bounds[2], cell[0])
        bounds[1], bounds[3] = min(bounds[1], cell[1]), max(bounds[3], cell[1])
        found += 1
    return found


@kernel
def _add(z_m: Float32, cells: Int, col0: int, row0: int, sum_m: Float, count: NDArray[np.int32]) -> None:
    for i in range(len(cells)):
        row, col = cells[i, 1] - row0, cells[i, 0] - col0
        sum_m[row, col] += z_m[cells[i, 2]]
        count[row, col] += 1
