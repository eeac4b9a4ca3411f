"""Saved maps of a run: the sequence `maps.npz`, one occupancy window per mapped scan; ground, clouds and dilution.

Row = y, column = x; the origin is the window's lower-left corner in map; the
windows are undilated. Members: `t_ns (S,)`, `origin_m (S, 2)`, `cell_m`,
`shape (2,)` and blocks `occupied_bits_000000 (maps of the block, rows,
ceil(columns / 8))` of numpy.packbits rows. A block holds about 1 MB, so that
memory does not grow with the length of the sequence.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import NotARun, TooLarge
from quadlog.messages import Float, Int
from quadlog.storage.npz import NpzReader, write_npz

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


_BLOCK_BYTES = 1 << 20
_MAX_MAPS = 20_000_000
_MAX_CELLS_PER_SIDE = 16384


class MapsWriter:
    """Writes maps one by one; the file appears when the `with` block ends without an error."""

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


class Occupancy(NamedTuple):
    """share (rows, columns) of the maps covering a cell that had it occupied, NaN where no map was; row = y."""

    share: Float
    origin_m: Float
    cell_m: float


MOST_CELLS = 4_000_000
"""Of an Occupancy; a larger area gets coarser cells, so that pictures and browsers can hold it."""
MOST_MAPS = 1000
"""Taken evenly from longer sequences for an Occupancy."""
FARTHEST_CELLS = 1e9
"""Windows farther out are errors, and would overflow."""


class MapSequence:
    """The maps of a run: t_ns (S,), origin_m (S, 2), cell_m, shape (rows, columns); iterates over OccupancyMap.

    Maps are unpacked on access; only the last block used is kept in memory.
    """

    def __init__(self, path: Path) -> None:
        self._npz = NpzReader(path)
        self._bits: NDArray[np.uint8] | None = None
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

    @classmethod
    def of(cls, origin_m: Float, cell_m: float, bits: NDArray[np.uint8], columns: int) -> Self:
        """Maps in memory: origin_m (S, 2), bits (S, rows, ceil(columns / 8)) of numpy.packbits along x; t_ns is 0."""
        made = cls.__new__(cls)
        made._bits, made.origin_m, made.cell_m = bits, np.asarray(origin_m, np.float64), cell_m
        made.t_ns, made.shape = np.zeros(len(bits), np.int64), (bits.shape[1], columns)
        made._block_number, made._block = -1, bits[:0]
        return made

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

    @cached_property
    def corner(self) -> Int:
        """(S, 2) column and row of each map's lower-left cell, counted from that of the area of all maps."""
        sane = (np.abs(self.origin_m) < FARTHEST_CELLS * self.cell_m).all(axis=1)
        least_m = self.origin_m[sane].min(axis=0) if sane.any() else np.zeros(2)
        return np.rint((self.origin_m - least_m) / self.cell_m).astype(np.int64)

    @cached_property
    def occupancy(self) -> Occupancy:
        """How often each cell of the area of all maps was occupied."""
        sane = np.flatnonzero((np.abs(self.corner) < FARTHEST_CELLS).all(axis=1))
        chosen = sane[np.unique(np.linspace(0, len(sane) - 1, min(len(sane), MOST_MAPS)).astype(int))]
        corner = self.corner[chosen]
        rows, columns = (corner.max(axis=0)[::-1] + self.shape).tolist()
        coarse = max(1, int(np.ceil(np.sqrt(rows * columns / MOST_CELLS))))
        size = (-(-rows // coarse), -(-columns // coarse))
        occupied, covered = np.zeros(size, np.int32), np.zeros(size, np.int32)
        for index, (column, row) in zip(chosen.tolist(), corner.tolist(), strict=True):
            last_row, last_column = (row + self.shape[0] - 1) // coarse, (column + self.shape[1] - 1) // coarse
            covered[row // coarse : last_row + 1, column // coarse : last_column + 1] += 1
            at_row, at_column = np.nonzero(self.occupied(index))
            occupied.flat[np.unique((at_row + row) // coarse * size[1] + (at_column + column) // coarse)] += 1
        share = np.where(covered > 0, occupied / np.maximum(covered, 1), np.nan)
        return Occupancy(share, self.origin_m[sane].min(axis=0), self.cell_m * coarse)

    def _read_block(self, number: int) -> NDArray[np.uint8]:
        each = _maps_per_block(self.shape)
        if self._bits is not None:
            return self._bits[number * each : (number + 1) * each]
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


_MAX_SAMPLE_BYTES = 1 << 30
_MAX_SAMPLES = 1000


@dataclass(frozen=True, slots=True)
class CloudSample:
    """One scan: xyz_m (N, 3) float32 in base, label (N,) uint8, the robot's pose in map (NaN where unknown)."""

    t_ns: int
    xyz_m: NDArray[np.float32]
    label: NDArray[np.uint8]
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class GroundMap:
    """Heights of the ground: origin_m (2,) lower-left corner in map, row = y, column = x.

    height_m (rows, columns) float64, NaN where no ground was seen; count (rows, columns) int64 points.
    """

    origin_m: Float
    cell_m: float
    height_m: Float
    count: NDArray[np.int64]


def write_cloud_samples(run: Path, samples: Iterable[CloudSample], classes: Sequence[str]) -> None:
    """`cloud_samples.npz`: the scans one after the other, scan k being rows offset[k] to offset[k + 1].

    `classes[label]` is the meaning of a label, and is saved, too.
    """
    kept = list(samples)
    with write_npz(run / "cloud_samples.npz") as npz:
        npz.add("t_ns", np.array([sample.t_ns for sample in kept], np.int64))
        npz.add("offset", np.cumsum([0, *(len(sample.xyz_m) for sample in kept)], dtype=np.int64))
        npz.add("xyz_m", np.concatenate([np.empty((0, 3), np.float32), *(s.xyz_m for s in kept)], dtype=np.float32))
        npz.add("label", np.concatenate([np.empty(0, np.uint8), *(s.label for s in kept)], dtype=np.uint8))
        for name in ("x_m", "y_m", "yaw_rad"):
            npz.add(name, np.array([getattr(sample, name) for sample in kept], np.float64))
        npz.add("classes", np.array(list(classes), "U16"))


def read_cloud_samples(run: Path) -> tuple[list[CloudSample], list[str]]:
    """The scans of `cloud_samples.npz` and the name of each label. Raises NotARun, TooLarge."""
    npz = NpzReader(run / "cloud_samples.npz")
    t_ns = npz.read("t_ns", np.int64, (None,), 8 * _MAX_SAMPLES + 4096)
    offset = npz.read("offset", np.int64, (len(t_ns) + 1,), 8 * _MAX_SAMPLES + 4096)
    xyz_m = npz.read("xyz_m", np.float32, (None, 3), _MAX_SAMPLE_BYTES)
    label = npz.read("label", np.uint8, (len(xyz_m),), _MAX_SAMPLE_BYTES)
    classes = npz.read("classes", "U16", (None,), 1 << 20).tolist()
    pose = [npz.read(name, np.float64, (len(t_ns),), 8 * _MAX_SAMPLES + 4096) for name in ("x_m", "y_m", "yaw_rad")]
    if offset[0] != 0 or offset[-1] != len(xyz_m) or (np.diff(offset) < 0).any():
        raise NotARun(npz.path, "is damaged: offset does not fit xyz_m")
    if len(label) and label.max() >= len(classes):
        raise NotARun(npz.path, "is damaged: a label without a class")
    scans = [slice(first, last) for first, last in pairwise(offset.tolist())]
    samples = [
        CloudSample(int(t_ns[k]), xyz_m[rows], label[rows], *(float(column[k]) for column in pose))
        for k, rows in enumerate(scans)
    ]
    return samples, classes


def write_ground(run: Path, ground: GroundMap) -> None:
    """`ground.npz`: `origin_m (2,)`, `cell_m`, `height_m` and `count`, both (rows, columns)."""
    if ground.height_m.shape != ground.count.shape:
        raise ValueError(f"height_m {ground.height_m.shape} and count {ground.count.shape} differ in shape")
    with write_npz(run / "ground.npz") as npz:
        npz.add("origin_m", np.asarray(ground.origin_m, np.float64))
        npz.add("cell_m", np.array(ground.cell_m, np.float64))
        npz.add("height_m", np.asarray(ground.height_m, np.float64))
        npz.add("count", np.asarray(ground.count, np.int64))


def read_ground(run: Path) -> GroundMap:
    """The ground's height map of a run folder. Raises NotARun, TooLarge."""
    npz = NpzReader(run / "ground.npz")
    height_m = npz.read("height_m", np.float64, (None, None), _MAX_SAMPLE_BYTES)
    count = npz.read("count", np.int64, height_m.shape, _MAX_SAMPLE_BYTES)
    origin_m = npz.read("origin_m", np.float64, (2,), 4096)
    cell_m = float(npz.read("cell_m", np.float64, (), 4096))
    if not (np.isfinite(origin_m).all() and np.isfinite(cell_m) and cell_m > 0):
        raise NotARun(npz.path, "is damaged: a ground without a place or a size")
    return GroundMap(origin_m, cell_m, height_m, count)
