"""Arrays of a run, `NAME.npz`: what each file holds, one codec for all of them, and the sequence of maps.

Bytes depend on the data alone; sizes are checked before anything is allocated.
"""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import NotARun, TooLarge
from quadlog.messages import Float, Int
from quadlog.results.record import reading
from quadlog.storage.atomic_write import whole_file

Array = NDArray[Any]
Shape = tuple[int | str | None, ...]

ARRAYS: dict[str, dict[str, tuple[str, Shape]]] = {
    "ground": {
        "origin_m": ("f8", (2,)),
        "cell_m": ("f8", ()),
        "height_m": ("f8", ("rows", "columns")),
        "count": ("i8", ("rows", "columns")),
    },
    "cloud_samples": {
        "t_ns": ("i8", ("scans",)),
        "offset": ("i8", ("borders",)),
        "xyz_m": ("f4", ("points", 3)),
        "label": ("u1", ("points",)),
        **dict.fromkeys(("x_m", "y_m", "yaw_rad"), ("f8", ("scans",))),
        "classes": ("U16", ("classes",)),
    },
}
"""Type and shape of the arrays in each file; lengths of one name are equal.

Origins are lower-left corners in map, row = y, column = x. ground: mean heights, NaN where no ground was seen, and
numbers of points. cloud_samples: points in base, one scan after the other, scan k being rows offset[k] to
offset[k + 1], their classes, and the robot's pose in map, NaN where it is unknown. `maps.npz` is a MapSequence.
"""

_MAX_BYTES, _HEADER_BYTES = 1 << 30, 4096
# Measurements as floats hardly shrink, and take most of the time.
_TRIED_BYTES, _WORTH_RATIO, _LEVEL = 1 << 14, 0.75, 1
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first instant a zip knows; numpy.savez writes the same


def write_arrays(run: Path, name: str, arrays: Mapping[str, Any]) -> None:
    """`NAME.npz` of a run folder, as ARRAYS has it. Raises ValueError for arrays that do not fit, CannotWrite."""
    sizes: dict[int | str | None, int] = {}
    with _write_npz(run / f"{name}.npz") as archive:
        for key, (dtype, shape) in ARRAYS[name].items():
            array = np.asarray(arrays[key], dtype)
            sizes = dict(zip(shape, array.shape, strict=True)) | sizes
            if array.shape != tuple(sizes[each] if isinstance(each, str) else each for each in shape):
                raise ValueError(f"{name}: {key} {array.shape} does not fit {shape} with {sizes}")
            _add(archive, key, array)


def read_arrays(run: Path, name: str) -> dict[str, Array]:
    """The arrays of `NAME.npz` of a run folder, as ARRAYS has them. Raises NotARun, TooLarge."""
    path, found = run / f"{name}.npz", {}
    sizes: dict[int | str | None, int] = {}
    with _open_npz(path) as archive:
        for key, (dtype, shape) in ARRAYS[name].items():
            wanted = tuple(sizes.get(each) if isinstance(each, str) else each for each in shape)
            found[key] = _read(archive, key, dtype, wanted)
            sizes |= dict(zip(shape, found[key].shape, strict=True))
        _check(found)
    return found


def _check(arrays: Mapping[str, Array]) -> None:
    """Raises ValueError for arrays that contradict each other."""
    if "cell_m" in arrays and not (np.isfinite(arrays["origin_m"]).all() and 0 < arrays["cell_m"] < np.inf):
        raise ValueError("a map without a place or a size")
    if "offset" in arrays:
        points, label = np.diff(arrays["offset"], prepend=0), arrays["label"]
        if len(points) != len(arrays["t_ns"]) + 1 or points[0] != 0 or points.min() < 0 or points.sum() != len(label):
            raise ValueError("offset does not fit xyz_m")
        if label.max(initial=0) >= max(1, len(arrays["classes"])):
            raise ValueError("a label without a class")


@contextmanager
def _write_npz(path: Path) -> Iterator[zipfile.ZipFile]:
    """An archive that appears, whole, as `path` when the block ends without an error. Raises CannotWrite."""
    with whole_file(path) as part, zipfile.ZipFile(part, "w") as archive:
        yield archive


def _add(archive: zipfile.ZipFile, name: str, array: Array) -> None:
    """An array as numpy.load finds it, deflated where that saves much."""
    member = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
    member.external_attr = 0o644 << 16
    member.create_system = 3  # Unix, wherever it is written
    content = io.BytesIO()
    np.lib.format.write_array(content, np.ascontiguousarray(array).reshape(array.shape), allow_pickle=False)
    begin = content.getbuffer()[:_TRIED_BYTES]
    worth = len(zlib.compress(begin, _LEVEL)) < _WORTH_RATIO * len(begin)
    archive.writestr(member, content.getbuffer(), zipfile.ZIP_DEFLATED if worth else zipfile.ZIP_STORED, _LEVEL)


@contextmanager
def _open_npz(path: Path) -> Iterator[zipfile.ZipFile]:
    """An untrusted archive to read from; whatever is wrong with it is a NotARun that names the file."""
    if not path.is_file():
        raise NotARun(path.parent, f"has no {path.name}")
    with reading(path), zipfile.ZipFile(path) as archive:
        yield archive


def _read(archive: zipfile.ZipFile, name: str, dtype: str, shape: Shape) -> Array:
    """One array, whose checksum is right; None in `shape` stands for any length.

    The declared size is checked before anything is allocated. Raises TooLarge; ValueError and what zipfile raises.
    """
    kind, known = np.dtype(dtype), [each for each in shape if isinstance(each, int)]
    limit = math.prod(known) * kind.itemsize + _HEADER_BYTES if len(known) == len(shape) else _MAX_BYTES
    if f"{name}.npy" not in archive.namelist():
        raise ValueError(f"it has no {name}")
    size = archive.getinfo(f"{name}.npy").file_size
    if size > limit:
        raise TooLarge(f"{archive.filename}: bytes of {name}", size, limit)
    content = archive.read(f"{name}.npy")
    body = io.BytesIO(content)
    if np.lib.format.read_magic(body) != (1, 0):
        raise ValueError(f"{name} is of an unknown version")
    found, fortran, found_kind = np.lib.format.read_array_header_1_0(body, max_header_size=_HEADER_BYTES)
    fits = len(found) == len(shape) and all(want in (None, n) for want, n in zip(shape, found, strict=True))
    if not fits or fortran or found_kind != kind or min(found, default=0) < 0:
        raise ValueError(f"{name} is {found_kind} {found}, not {kind} {shape}")
    if len(content) - body.tell() != math.prod(found) * kind.itemsize:
        raise ValueError(f"{name} is cut")
    return np.frombuffer(content, kind, offset=body.tell()).reshape(found).copy()


_BLOCK_BYTES = 1 << 20
"""Packed bits of maps that are written and read at once, so that memory does not grow with the sequence."""
_MAX_CELLS_PER_SIDE, _BLOCK = 16384, "occupied_bits_{:06d}"


class MapsWriter(ExitStack[bool | None]):
    """Writes maps one by one into `maps.npz`, which appears when the `with` block ends without an error.

    Members: blocks `occupied_bits_000000 (maps of the block, rows, ceil(columns / 8))` of numpy.packbits rows,
    t_ns (S,), origin_m (S, 2), cell_m, shape (2,).
    """

    def __init__(self, path: Path, cell_m: float, shape: tuple[int, int]) -> None:
        super().__init__()
        self.path, self.cell_m, self.shape = path, cell_m, shape
        self._t_ns: list[int] = []
        self._origin_m: list[tuple[float, float]] = []
        self._block: list[NDArray[np.uint8]] = []

    def __enter__(self) -> Self:
        self._archive = self.enter_context(_write_npz(self.path))
        self.push(self._finish)
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

    def _finish(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            return
        if self._block:
            self._write_block()
        _add(self._archive, "t_ns", np.array(self._t_ns, np.int64))
        _add(self._archive, "origin_m", np.array(self._origin_m, np.float64).reshape(-1, 2))
        _add(self._archive, "cell_m", np.array(self.cell_m, np.float64))
        _add(self._archive, "shape", np.array(self.shape, np.int64))

    def _write_block(self) -> None:
        first = len(self._t_ns) - len(self._block)
        _add(self._archive, _BLOCK.format(first // _maps_per_block(self.shape)), np.stack(self._block))
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

    Maps are undilated, origins are lower-left corners in map, row = y, column = x. They are unpacked on access; only
    the last block used is kept in memory.
    """

    def __init__(self, path: Path) -> None:
        """Raises NotARun, TooLarge."""
        self._path = path
        with _open_npz(path) as archive:
            self.t_ns: Int = _read(archive, "t_ns", "i8", (None,))
            self.origin_m: Float = _read(archive, "origin_m", "f8", (len(self.t_ns), 2))
            self.cell_m = float(_read(archive, "cell_m", "f8", ()))
            rows, columns = _read(archive, "shape", "i8", (2,)).tolist()
            if not (0 < rows <= _MAX_CELLS_PER_SIDE and 0 < columns <= _MAX_CELLS_PER_SIDE):
                raise TooLarge(f"{path}: cells on a side", max(rows, columns), _MAX_CELLS_PER_SIDE)
            _check({"origin_m": self.origin_m, "cell_m": np.array(self.cell_m)})
        self.shape = (rows, columns)
        self._block_number, self._block = -1, np.empty((0, 0, 0), np.uint8)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __iter__(self) -> Iterator[OccupancyMap]:
        for i in range(len(self)):
            yield OccupancyMap(int(self.t_ns[i]), self.origin_m[i], self.occupied(i))

    def occupied(self, i: int) -> NDArray[np.bool_]:
        """(rows, columns) bool of map `i`, a copy. Raises IndexError, or NotARun for a damaged file."""
        if not 0 <= i < len(self):
            raise IndexError(f"map {i} of {len(self)}")
        number, place = divmod(i, each := _maps_per_block(self.shape))
        if number != self._block_number:
            shape = (min(each, len(self) - number * each), self.shape[0], -(-self.shape[1] // 8))
            with _open_npz(self._path) as archive:
                self._block, self._block_number = _read(archive, _BLOCK.format(number), "u1", shape), number
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
        occupied, covered = np.zeros((2, *size), np.uint16)  # of MOST_MAPS at most
        for index, (column, row) in zip(chosen.tolist(), corner.tolist(), strict=True):
            part, place = self.occupied(index), []
            for axis, first in enumerate((row, column)):
                at = np.arange(first, first + self.shape[axis]) // coarse
                place.append(slice(at[0], at[-1] + 1))
                if coarse > 1:
                    part = np.logical_or.reduceat(part, np.flatnonzero(np.diff(at, prepend=-1)), axis)
            covered[tuple(place)] += 1
            occupied[tuple(place)] += part
        share = np.where(covered > 0, occupied / np.maximum(covered, 1), np.nan)
        return Occupancy(share, self.origin_m[sane].min(axis=0), self.cell_m * coarse)


def load_maps(run: Path) -> MapSequence:
    """The recorded map sequence of a run folder. Raises NotARun, TooLarge."""
    return MapSequence(Path(run) / "maps.npz")


def _maps_per_block(shape: tuple[int, int]) -> int:
    return max(1, _BLOCK_BYTES // (shape[0] * -(-shape[1] // 8)))
