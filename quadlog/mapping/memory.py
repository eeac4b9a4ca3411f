"""What maps keep of scans: log odds cleared by rays that pass through; and maps of the whole run: how often each cell
was seen occupied or seen through, and how high the ground is.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from quadlog.compiled import kernel
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass, Returns
from quadlog.mapping.grid import MOST_CELLS, Grid, GrowingLattice, Window, window_around
from quadlog.mapping.placing import NO_TOP, PlacedScan, place_at, slot_transforms
from quadlog.messages import Float, Float32

Int16 = NDArray[np.int16]
Count = NDArray[np.int32]

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
            if not hit and lasting == none:
                here[col] = False
                continue
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
        hits, row, col = self.lattice.whole("hits", window)
        _count(*placed, hits, self.lattice.whole("passes", window)[0], row, col, below_mm)

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


@kernel
def _count(
    top_mm: Int16, lowest_ray_mm: Int16, hits: Count, passes: Count, first_row: int, first_col: int, below_mm: int
) -> None:
    below, one, none = np.int32(below_mm), np.int32(1), np.int32(0)
    for row in range(len(top_mm)):
        tops, rays = top_mm[row], lowest_ray_mm[row]
        hit, passed = hits[first_row + row, first_col:], passes[first_row + row, first_col:]
        for col in range(len(tops)):
            hit[col] += one if tops[col] > NO_TOP else none
        for col in range(len(tops)):
            passed[col] += one if (rays[col] < below) & (tops[col] == NO_TOP) else none


@kernel
def _sum_heights(returns: Returns, transforms: Float, reach_m: float, per_m: float, sum_m: Float, count: Count) -> None:
    rows, cols = count.shape
    for i in range(len(returns.label)):
        dx_m, dy_m = returns.dx_m[i], returns.dy_m[i]
        if returns.label[i] != np.uint8(PointClass.GROUND) or dx_m * dx_m + dy_m * dy_m > reach_m * reach_m:
            continue
        x_m, y_m = place_at(returns, i, transforms)
        x, y = x_m * per_m, y_m * per_m
        if 0 <= x < cols and 0 <= y < rows:
            row, col = np.int64(y), np.int64(x)
            sum_m[row, col] += returns.z_m[i]
            count[row, col] += 1


# How far a robot moves while a scan lasts.
_MOVED_M = 1.0


class GroundHeight:
    """Sum and count of ground points' heights per cell, on a lattice that grows with the run, as that of a map does."""

    def __init__(self, cell_m: float) -> None:
        self._cell_m = cell_m
        self.lattice = GrowingLattice(cell_m, {"sum_m": np.float64, "count": np.int32}, MOST_CELLS // 4)

    def add(self, scan: ClassifiedScan, slot_pose_base_in_map: Float, reach_m: float) -> None:
        """Count one scan's ground up to reach_m from the lidar; slot_pose_base_in_map: (K, 3) at its time slots."""
        half = math.ceil((reach_m + _MOVED_M + math.hypot(*scan.lidar_base_m[:2])) / self._cell_m)
        window = window_around(slot_pose_base_in_map[0, :2], self._cell_m, 2 * half + 1)
        if scan.counts[PointClass.GROUND] == 0 or not self.lattice.cover(window):
            return
        transforms = slot_transforms(scan, slot_pose_base_in_map, window.origin_m)
        layers = (self.lattice.view(name, window) for name in ("sum_m", "count"))
        _sum_heights(scan.returns, transforms, float(reach_m), 1 / self._cell_m, *layers)

    def to_map(self) -> tuple[Float32, Count, Window] | None:
        """The mean height of the ground in every cell (rows, cols), NaN where none was seen, how many points it is of,
        and the window they fill; None when no ground was seen.
        """
        whole = self.lattice.covered
        if whole is None:
            return None
        rows, cols = np.nonzero(self.lattice.view("count", whole))
        if len(rows) == 0:
            return None
        shape = int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1
        window = Window(whole.col0 + int(cols.min()), whole.row0 + int(rows.min()), whole.cell_m, shape)
        count, sum_m = (self.lattice.view(name, window) for name in ("count", "sum_m"))
        height_m = np.where(count > 0, sum_m / np.maximum(count, 1), np.nan).astype(np.float32)
        return height_m, count, window
