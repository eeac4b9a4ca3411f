"""What a map remembers of earlier scans: nothing, everything for a while, or all that was not seen through since."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.lattice import Layers
from quadlog.mapping.occupancy import Grid
from quadlog.mapping.window import Window

HIT_S = 0.2
"""A cell that was hit once survives this much contradicting sight; a false point is gone after two scans at 10 Hz."""
LONGEST_STEP_S = 0.2
"""A gap between scans says nothing: it contradicts no longer than this."""


class Memory(Protocol):
    """A map that scans are added to, one after the other."""

    skipped: int
    """Scans that could not be remembered, for want of room; their maps hold that scan alone."""

    def add(self, t_ns: int, window: Window, top_m: NDArray[np.float32], lowest_ray_m: NDArray[np.float32]) -> Grid:
        """The occupied cells (rows, cols) of a window after a scan at t_ns.

        top_m: (rows, cols) height above ground of the highest obstacle point in each cell, -inf where there is none.
        lowest_ray_m: (rows, cols) as `lowest_rays` gives it.
        """


class ScanMemory:
    """No memory: the map is this scan. [Following]"""

    skipped = 0

    def add(self, t_ns: int, window: Window, top_m: NDArray[np.float32], lowest_ray_m: NDArray[np.float32]) -> Grid:
        """The cells hit now."""
        return np.isfinite(top_m)


class DecayMemory:
    """A cell stays occupied for decay_s after it was last hit, whatever was seen since."""

    LAYERS: ClassVar = {"hit_ns": np.int64}

    def __init__(self, layers: Layers, decay_s: float) -> None:
        self._layers, self._decay_ns = layers, round(decay_s * 1e9)
        self.skipped = 0

    def add(self, t_ns: int, window: Window, top_m: NDArray[np.float32], lowest_ray_m: NDArray[np.float32]) -> Grid:
        """The cells hit within the last decay_s."""
        hit = np.isfinite(top_m)
        if not self._layers.cover(window):
            self.skipped += 1
            return hit
        hit_ns = self._layers.view("hit_ns", window)
        hit_ns[hit] = t_ns
        occupied: Grid = (hit_ns != 0) & (t_ns - hit_ns <= self._decay_ns)
        return occupied


class LogOddsMemory:
    """A cell stays occupied until rays have crossed it below the top of what stood there for long enough.

    Log odds with a floor at "free" and a ceiling, in seconds of contradicting
    sight: a hit adds HIT_S up to clear_s, a scan that sees through takes the
    time since the scan before. So what is out of sight stays, and what has
    moved away is gone clear_s after it was seen to be, at any scan rate.
    A ray that passes above a low obstacle does not contradict it.
    """

    LAYERS: ClassVar = {"evidence_s": np.float32, "top_m": np.float32}

    def __init__(self, layers: Layers, clear_s: float) -> None:
        self._layers, self._clear_s = layers, clear_s
        self._last_ns: int | None = None
        self.skipped = 0

    def add(self, t_ns: int, window: Window, top_m: NDArray[np.float32], lowest_ray_m: NDArray[np.float32]) -> Grid:
        """The cells hit now, and those hit before that nothing contradicts."""
        hit = np.isfinite(top_m)
        if not self._layers.cover(window):
            self.skipped += 1
            return hit
        passed_s = 0.0 if self._last_ns is None else min(max((t_ns - self._last_ns) * 1e-9, 0.0), LONGEST_STEP_S)
        self._last_ns = t_ns
        evidence_s, remembered_m = self._layers.view("evidence_s", window), self._layers.view("top_m", window)
        crossed = ~hit & (lowest_ray_m < remembered_m)
        evidence_s[crossed] = np.maximum(evidence_s[crossed] - passed_s, 0.0)
        # Rounding must not leave a cell occupied by a hundredth of a scan.
        evidence_s[evidence_s < 1e-3] = 0.0
        evidence_s[hit] = np.minimum(evidence_s[hit] + HIT_S, self._clear_s)
        remembered_m[hit] = np.maximum(remembered_m[hit], top_m[hit])
        remembered_m[evidence_s == 0.0] = 0.0
        occupied: Grid = evidence_s > 0.0
        return occupied
