"""The ground that a run saw, for a robot to walk on: its `ground.npz`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from quadlog.errors import NotARun
from quadlog.messages import Float
from quadlog.results.record import describe_input
from quadlog.results.samples import read_ground
from quadlog.simulation.ground import Extent, Ground, from_height_map

LEAST_POINTS = 5
"""A cell of the ground that was seen less is as high as those around it: far away, a point may be anything's."""
NEAR_M = 0.5
"""So far from the nearest cell that was seen the ground is still what that cell says."""
WALKED_M = 1.0
"""So far from its course a robot that follows it may set a foot. Farther off, walls and bushes may pass for ground."""
# What no ground that a robot saw is beyond: a file may say anything.
_MOST_M, _CELLS_M = 1e6, (1e-3, 1e3)


@dataclass(frozen=True, slots=True)
class SeenGround:
    """ground: gaps filled by the nearest seen cell. seen_m: centres (N, 2) of the cells that were seen. run: whose."""

    run: Path
    ground: Ground
    seen_m: Float

    def beyond(self, path_m: Float) -> str | None:
        """How much of a path (K, 2) in map lies beyond what was seen, and from where on; None for nothing of it."""
        places_m, step_m = _places_along(path_m, NEAR_M / 5)
        away_m, _ = cKDTree(self.seen_m).query(places_m, distance_upper_bound=NEAR_M)
        beyond = ~np.isfinite(away_m)
        if not beyond.any():
            return None
        x_m, y_m = places_m[beyond.argmax()]
        return (
            f"{beyond.sum() * step_m:.1f} of the course's {len(places_m) * step_m:.1f} m, the first at "
            f"({x_m:.1f}, {y_m:.1f}) m, lie beyond the ground that {self.run} saw: each such place is taken to be as "
            f"high as its nearest edge"
        )

    def too_steep_along(self, path_m: Float, friction: float) -> str | None:
        """Why a foot cannot hold somewhere beside a path (K, 2) in map, None when it can; see Ground.too_steep_for."""
        for x_m, y_m in _places_along(path_m, WALKED_M)[0].tolist():
            beside = self.ground.over(Extent(x_m - WALKED_M, y_m - WALKED_M, x_m + WALKED_M, y_m + WALKED_M))
            if (reason := beside.too_steep_for(friction)) is not None:
                return reason
        return None

    def provenance(self) -> str:
        """One line about where it comes from."""
        file = describe_input(self.run / "ground.npz")
        return f"the ground is what {self.run} saw (ground.npz, SHA-256 {file.sha256})"


def seen_ground(run: Path) -> SeenGround | None:
    """What a run saw of its ground, None when nothing of it. Raises NotARun and TooLarge."""
    seen = read_ground(run)
    if max(np.abs(seen.origin_m).max(), np.nanmax(np.abs(seen.height_m), initial=0.0)) > _MOST_M:
        raise NotARun(run / "ground.npz", "is damaged: it tells of a ground that is nowhere on earth")
    if not _CELLS_M[0] <= seen.cell_m <= _CELLS_M[1]:
        raise NotARun(run / "ground.npz", f"is damaged: cells of {seen.cell_m:g} m")
    height_m = np.where(seen.count >= LEAST_POINTS, seen.height_m, np.nan)
    rows, cols = np.nonzero(np.isfinite(height_m))
    if not len(rows):
        return None
    seen_m = seen.origin_m + (np.stack([cols, rows], axis=1) + 0.5) * seen.cell_m
    return SeenGround(run, from_height_map(height_m, seen.cell_m, seen.origin_m), seen_m)


def _places_along(path_m: Float, step_m: float) -> tuple[Float, float]:
    """(N, 2) middles of equal pieces of a path, about step_m long, and how long they are."""
    arc_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    pieces = max(math.ceil(arc_m[-1] / step_m), 1)
    step_m = float(arc_m[-1]) / pieces
    middles_m = (np.arange(pieces) + 0.5) * step_m
    return np.column_stack([np.interp(middles_m, arc_m, path_m[:, k]) for k in range(2)]), step_m
