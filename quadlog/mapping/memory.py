"""Memory of maps between scans: none, or log odds cleared by rays that pass through."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from quadlog.compiled import kernel
from quadlog.mapping.grid import Grid, GrowingLattice, Window
from quadlog.mapping.placing import NO_TOP, PlacedScan

Int16 = NDArray[np.int16]

_HIT_MS = np.int16(200)
"""A cell that was hit once survives this much contradicting sight; a false point is gone after two scans at 10 Hz."""
LONGEST_STEP_S = 0.2
"""Longest time between scans that counts as contradicting sight."""
_LONGEST_MS = 32000
_SAME_HEIGHT_MM = np.int16(1)
# An obstacle higher by this than the cell's top is stored as a second one above it.
_STACKED_MM = np.int16(150)


class Memory(Protocol):
    """A map that scans are added to, one after the other."""

    skipped: int
    """Scans that could not be remembered, for want of room; their maps hold that scan alone."""

    def add(self, t_ns: int, window: Window, placed: PlacedScan) -> Grid:
        """The occupied cells (rows, cols) of a window after a scan at t_ns that was placed in it."""


class ScanMemory:
    """No memory: the map is this scan. [Following]"""

    skipped = 0

    def add(self, t_ns: int, window: Window, placed: PlacedScan) -> Grid:
        """The cells hit now."""
        return placed.top_mm > NO_TOP


class LogOddsMemory:
    """A cell stays occupied until rays have crossed it below the top of what stood there for long enough.

    Log odds with a floor at "free" and a ceiling, in milliseconds of contradicting sight: a hit adds _HIT_MS up to
    clear_s, a scan that sees through takes the time since the scan before. So what is out of sight stays, and what has
    moved away is gone clear_s after it was seen to be, at any scan rate. A ray that passes above a low obstacle does
    not contradict it; one that passes where it was hit does, or a scan in a plane would never clear.
    A cell holds two things, one above the other, each with its own evidence: what was seen twice and is
    then overtopped, as a crate by a person who steps over it, outlasts what has been above it. The height of the lower
    one falls to that of the rays that pass above it while it is hit.
    """

    LAYERS: ClassVar[dict[str, DTypeLike]] = dict.fromkeys(("low_ms", "low_mm", "high_ms", "high_mm"), np.int16)

    def __init__(self, layers: GrowingLattice, clear_s: float) -> None:
        self._layers, self._clear_ms = layers, np.int16(min(max(round(clear_s * 1e3), 1), _LONGEST_MS))
        self._last_ns: int | None = None
        self.skipped = 0

    def add(self, t_ns: int, window: Window, placed: PlacedScan) -> Grid:
        """The cells hit now, and those hit before that nothing contradicts."""
        if not self._layers.cover(window):
            self.skipped += 1
            return placed.top_mm > NO_TOP
        passed_s = 0.0 if self._last_ns is None else min(max((t_ns - self._last_ns) * 1e-9, 0.0), LONGEST_STEP_S)
        self._last_ns = t_ns
        occupied: Grid = np.empty(window.shape, np.bool_)
        low_ms, row, col = self._layers.whole("low_ms", window)
        others = [self._layers.whole(name, window)[0] for name in ("low_mm", "high_ms", "high_mm")]
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
