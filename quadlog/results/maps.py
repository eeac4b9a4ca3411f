"""The map sequence `maps.npz`: one occupancy window per mapped scan, packed to bits.

Row = y, column = x; the origin is the window's lower-left corner in map; the
windows are undilated. Members: `t_ns (S,)`, `origin_m (S, 2)`, `cell_m`,
`shape (2,)` and blocks `occupied_bits_000000 (maps of the block, rows,
ceil(columns / 8))` of numpy.packbits rows. A block holds about 1 MB, so that
writing and looking something up take the same little memory for any length.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import NotARun, TooLarge
from quadlog.messages import Float, Int
from quadlog.results.npz import NpzReader, write_npz

_BLOCK_BYTES = 1 << 20
_MAX_MAPS = 20_000_000
_MAX_CELLS_PER_SIDE = 16384


class MapsWriter:
    """Takes one map after the other; the file appears when the `with` block ends without an error."""

    def __init__(self, path: Path, cell_m: float, shape: tuple[int, int]) -> None:
        self.path, self.cell_m, self.shape = path, cell_m, shape
        self._t_ns: list[int] = []
        self._origin_m: list[tuple[float, float]] = []
        self._block: list[NDArray[np.uint8]] = []

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._npz = stack.enter_context(write_npz(self.path))
            self._stack = stack.pop_all()
        return self

    def append(self, t_ns: int, origin_m: Float, occupied: NDArray[np.bool_]) -> None:
        """One map: origin_m (2,) in map, occupied (rows, columns) bool."""
        if occupied.shape != self.shape or occupied.dtype != np.bool_:
            raise ValueError(f"a map is bool {self.shape}, not {occupied.dtype} {occupied.shape}")
        self._t_ns.append(int(t_ns))
        self._origin_m.append((float(origin_m[0]), float(origin_m[1])))
        self._block.append(np.packbits(occupied, axis=1))
        if len(self._block) == _maps_per_block(self.shape):
            self._write_block()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack:
            if error is not None:
                raise error
            if self._block:
                self._write_block()
            self._npz.add("t_ns", np.array(self._t_ns, np.int64))
            self._npz.add("origin_m", np.array(self._origin_m, np.float64).reshape(-1, 2))
            self._npz.add("cell_m", np.array(self.cell_m, np.float64))
            self._npz.add("shape", np.array(self.shape, np.int64))

    def _write_block(self) -> None:
        first = len(self._t_ns) - len(self._block)
        self._npz.add(_block_name(first // _maps_per_block(self.shape)), np.stack(self._block))
        self._block.clear()


class OccupancyMap(NamedTuple):
    """One window: t_ns, origin_m (2,) its lower-left corner in map, occupied (rows, columns) bool."""

    t_ns: int
    origin_m: Float
    occupied: NDArray[np.bool_]


class MapSequence:
    """The maps of a run: t_ns (S,), origin_m (S, 2), cell_m, shape (rows, columns); iterates over OccupancyMap.

    Maps are unpacked when asked for; only the block last used stays in memory.
    """

    def __init__(self, path: Path) -> None:
        self._npz = NpzReader(path)
        self.t_ns: Int = self._npz.read("t_ns", np.int64, (None,), 8 * _MAX_MAPS)
        self.origin_m: Float = self._npz.read("origin_m", np.float64, (len(self.t_ns), 2), 16 * _MAX_MAPS + 4096)
        self.cell_m = float(self._npz.read("cell_m", np.float64, (), 4096))
        rows, columns = self._npz.read("shape", np.int64, (2,), 4096).tolist()
        self.shape = (rows, columns)
        if not (0 < rows <= _MAX_CELLS_PER_SIDE and 0 < columns <= _MAX_CELLS_PER_SIDE):
            raise TooLarge(f"{path}: cells on a side", max(rows, columns), _MAX_CELLS_PER_SIDE)
        if not (np.isfinite(self.origin_m).all() and np.isfinite(self.cell_m) and self.cell_m > 0):
            raise NotARun(path, "is damaged: a map without a place or a size")
        self._block_number = -1
        self._block = np.empty((0, 0, 0), np.uint8)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __iter__(self) -> Iterator[OccupancyMap]:
        for i in range(len(self)):
            yield OccupancyMap(int(self.t_ns[i]), self.origin_m[i], self.occupied(i))

    def occupied(self, i: int) -> NDArray[np.bool_]:
        """(rows, columns) bool of map `i`, a copy. Raises IndexError, or NotARun for a damaged file."""
        if not 0 <= i < len(self):
            raise IndexError(f"map {i} of {len(self)}")
        number, place = divmod(i, _maps_per_block(self.shape))
        if number != self._block_number:
            self._block, self._block_number = self._read_block(number), number
        return np.unpackbits(self._block[place], axis=1, count=self.shape[1]).view(np.bool_)

    def _read_block(self, number: int) -> NDArray[np.uint8]:
        each = _maps_per_block(self.shape)
        rows, columns = self.shape
        count = min(each, len(self) - number * each)
        width = (columns + 7) // 8
        return self._npz.read(_block_name(number), np.uint8, (count, rows, width), count * rows * width + 4096)


def load_maps(run: Path) -> MapSequence:
    """The recorded map sequence of a run folder. Raises NotARun, TooLarge."""
    return MapSequence(Path(run) / "maps.npz")


def _maps_per_block(shape: tuple[int, int]) -> int:
    return max(1, _BLOCK_BYTES // (shape[0] * ((shape[1] + 7) // 8)))


def _block_name(number: int) -> str:
    return f"occupied_bits_{number:06d}"
