"""The saved map of dilution of precision: `dilution.npz`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadlog.errors import NotARun
from quadlog.messages import Float
from quadlog.results.npz import NpzReader, write_npz

_MAX_BYTES = 1 << 24


@dataclass(frozen=True, slots=True)
class DilutionGrid:
    """HDOP on cells of map: hdop (rows, columns) float64, row = y, inf where ranges give no fix.

    origin_m (2,) lower-left corner in map; tag_height_m the height it holds for.
    """

    origin_m: Float
    cell_m: float
    tag_height_m: float
    hdop: Float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top edge in map, as imshow takes them."""
        (left, bottom), (rows, columns) = self.origin_m.tolist(), self.hdop.shape
        return left, left + columns * self.cell_m, bottom, bottom + rows * self.cell_m


def write_dilution(run: Path, grid: DilutionGrid) -> None:
    """`dilution.npz`: `hdop (rows, columns)`, `origin_m (2,)`, `cell_m`, `tag_height_m`."""
    with write_npz(run / "dilution.npz") as npz:
        npz.add("origin_m", np.asarray(grid.origin_m, np.float64))
        npz.add("cell_m", np.array(grid.cell_m, np.float64))
        npz.add("tag_height_m", np.array(grid.tag_height_m, np.float64))
        npz.add("hdop", np.asarray(grid.hdop, np.float64))


def read_dilution(run: Path) -> DilutionGrid:
    """The map of a run folder. Raises NotARun, TooLarge."""
    npz = NpzReader(run / "dilution.npz")
    hdop = npz.read("hdop", np.float64, (None, None), _MAX_BYTES)
    origin_m = npz.read("origin_m", np.float64, (2,), 4096)
    cell_m, height_m = (float(npz.read(name, np.float64, (), 4096)) for name in ("cell_m", "tag_height_m"))
    if not (np.isfinite([*origin_m, cell_m, height_m]).all() and cell_m > 0 and hdop.size):
        raise NotARun(npz.path, "is damaged: a map without a place or a size")
    return DilutionGrid(origin_m, cell_m, height_m, hdop)
