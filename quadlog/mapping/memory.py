"""What a map remembers of earlier scans: nothing, everything for a while, or all that was not seen through since."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.lattice import Layers
from quadlog.mapping.occupancy import Grid
from quadlog.mapping.window import Window
from quadlog.messages import Float32

HIT_S = 0.2
"""A cell that was hit once survives this much contradicting sight; a false point is gone after two scans at 10 Hz."""
LONGEST_STEP_S = 0.2
"""A gap between scans says nothing: it contradicts no longer than this."""
_LEAST_S = 1e-3
_SAME_HEIGHT_M = np.float32(1e-3)


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
    A ray that passes above a low obstacle does not contradict it; one that
    passes where it was hit does, or a scan in a plane would never clear.
    """

    LAYERS: ClassVar = {"evidence_s": np.float32, "top_m": np.float32}

    def __init__(self, layers: Layers, clear_s: float) -> None:
        self._layers, self._clear_s = layers, clear_s
        self._last_ns: int | None = None
        self.skipped = 0

    def add(self, t_ns: int, window: Window, top_m: NDArray[np.float32], lowest_ray_m: NDArray[np.float32]) -> Grid:
        """The cells hit now, and those hit before that nothing contradicts."""
        if not self._layers.cover(window):
            self.skipped += 1
            return np.isfinite(top_m)
        passed_s = 0.0 if self._last_ns is None else min(max((t_ns - self._last_ns) * 1e-9, 0.0), LONGEST_STEP_S)
        self._last_ns = t_ns
        occupied: Grid = np.empty(window.shape, np.bool_)
        layers = self._layers.view("evidence_s", window), self._layers.view("top_m", window)
        _remember(top_m, lowest_ray_m, *layers, passed_s, self._clear_s, occupied)
        return occupied


# Compiled: a dozen masks of the window took numpy as long as all of a scan's points.
@njit(cache=True, error_model="numpy")
def _remember(
    top_m: Float32,
    lowest_ray_m: Float32,
    evidence_s: Float32,
    remembered_m: Float32,
    passed_s: float,
    clear_s: float,
    occupied: Grid,
) -> None:
    for row in range(top_m.shape[0]):
        for col in range(top_m.shape[1]):
            evidence, remembered, top = evidence_s[row, col], remembered_m[row, col], top_m[row, col]
            if top > -np.inf:
                evidence = min(evidence + HIT_S, clear_s)
                remembered = max(remembered, top)
            elif evidence > 0 and lowest_ray_m[row, col] <= remembered + _SAME_HEIGHT_M:
                evidence -= passed_s
            # Rounding must not leave a cell occupied by a hundredth of a scan.
            occupied[row, col] = evidence >= _LEAST_S
            evidence_s[row, col] = evidence if evidence >= _LEAST_S else 0.0
            remembered_m[row, col] = remembered if evidence >= _LEAST_S else 0.0
