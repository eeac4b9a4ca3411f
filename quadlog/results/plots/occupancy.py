"""The map sequence as one picture: in which share of the maps that covered a cell it was occupied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.results.maps import MapSequence
from quadlog.results.plots.style import thin_points

MAX_CELLS = 4_000_000  # of the picture; larger areas are drawn with coarser cells
MAX_MAPS = 1000  # taken evenly from longer sequences
STANDS_M = 1.0  # across: what a robot saw is all there is to look at when it walked less
MAX_COORDINATE_CELLS = 1e9  # a window farther out than this is a mistake, and would overflow the arithmetic


@dataclass(frozen=True, slots=True)
class Occupancy:
    """share (rows, columns) in 0..1, NaN where no map ever was; row = y, origin_m (2,) the lower-left corner."""

    share: Float
    origin_m: Float
    cell_m: float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """left, right, bottom, top in metres, as imshow takes them."""
        rows, columns = self.share.shape
        left, bottom = float(self.origin_m[0]), float(self.origin_m[1])
        return left, left + columns * self.cell_m, bottom, bottom + rows * self.cell_m

    @property
    def corners_m(self) -> Float:
        """(2, 2) lower-left and upper-right corner of the cells that were ever occupied; (0, 2) where none was."""
        row, column = np.nonzero(np.nan_to_num(self.share) > 0)
        if not len(row):
            return np.zeros((0, 2))
        cells = np.array([[column.min(), row.min()], [column.max() + 1, row.max() + 1]])
        return self.origin_m + self.cell_m * cells


def seen_around(walked_m: Float, occupancy: Occupancy | None) -> Float:
    """Corners (2, 2) of all that a robot saw whose walk (N, 2) is shorter than STANDS_M; (0, 2) of a longer one."""
    stands = len(walked_m) and np.ptp(walked_m, axis=0).max() < STANDS_M
    return occupancy.corners_m if stands and occupancy is not None else np.zeros((0, 2))


def accumulate(maps: MapSequence) -> Occupancy | None:
    """Occupied / covering maps per cell of the area that all windows cover together; None without maps."""
    sane = np.flatnonzero((np.abs(maps.origin_m) < MAX_COORDINATE_CELLS * maps.cell_m).all(axis=1))
    if not len(sane):
        return None
    chosen = sane[thin_points(len(sane), MAX_MAPS)]
    origin_m = maps.origin_m[chosen].min(axis=0)
    corner = np.rint((maps.origin_m[chosen] - origin_m) / maps.cell_m).astype(np.int64)  # (S, 2) column, row
    rows, columns = (int(size) for size in corner.max(axis=0)[::-1] + np.array(maps.shape))
    coarse = max(1, int(np.ceil(np.sqrt(rows * columns / MAX_CELLS))))
    size = (-(-rows // coarse), -(-columns // coarse))
    occupied, covered = np.zeros(size, np.int64), np.zeros(size, np.int64)
    for index, (column, row) in zip(chosen, corner, strict=True):
        at_row, at_column = np.nonzero(maps.occupied(int(index)))
        cells = (at_row + row) // coarse * size[1] + (at_column + column) // coarse
        cells = np.unique(cells) if coarse > 1 else cells
        occupied.flat[cells] += 1
        last_row, last_column = (row + maps.shape[0] - 1) // coarse, (column + maps.shape[1] - 1) // coarse
        covered[row // coarse : last_row + 1, column // coarse : last_column + 1] += 1
    share = np.where(covered > 0, occupied / np.maximum(covered, 1), np.nan)
    return Occupancy(share, origin_m, maps.cell_m * coarse)
