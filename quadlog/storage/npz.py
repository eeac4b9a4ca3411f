"""Compressed arrays as numpy reads them, with bytes that depend on the data alone and sizes checked before use."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from quadlog.errors import NotARun, TooLarge
from quadlog.storage.atomic_write import whole_file

# Measurements as floats hardly shrink, and take most of the time.
_TRIED_BYTES, _WORTH_RATIO, _LEVEL = 1 << 14, 0.75, 1
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first instant a zip knows; numpy.savez writes the same


class NpzWriter:
    """Adds arrays one by one to an open archive, deflated where that saves much, none of them kept in memory."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive

    def add(self, name: str, array: NDArray[Any]) -> None:
        """`array` as the member `name`, which `numpy.load(...)[name]` finds."""
        member = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
        member.external_attr = 0o644 << 16
        member.create_system = 3  # Unix, wherever it is written
        content = io.BytesIO()
        np.lib.format.write_array(content, np.ascontiguousarray(array).reshape(array.shape), allow_pickle=False)
        begin = content.getbuffer()[:_TRIED_BYTES]
        worth = len(zlib.compress(begin, _LEVEL)) < _WORTH_RATIO * len(begin)
        kind = zipfile.ZIP_DEFLATED if worth else zipfile.ZIP_STORED
        self._archive.writestr(member, content.getbuffer(), kind, _LEVEL)


@contextmanager
def write_npz(path: Path) -> Iterator[NpzWriter]:
    """An archive that appears, whole, as `path` when the block ends without an error. Raises CannotWrite."""
    with whole_file(path) as part, zipfile.ZipFile(part, "w") as archive:
        yield NpzWriter(archive)


class NpzReader:
    """Reads single arrays of an untrusted archive; every failure is a NotARun that names the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise NotARun(path.parent, f"has no {path.name}")
        try:
            self._archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
            raise NotARun(path, f"is damaged or no .npz: {error}") from error

    def read(self, name: str, dtype: DTypeLike, shape: tuple[int | None, ...], max_bytes: int) -> NDArray[Any]:
        """The array `name`; None in `shape` stands for any length.

        The size that the archive declares is checked before anything is
        allocated, and its checksum after. Raises NotARun, TooLarge.
        """
        try:
            size = self._archive.getinfo(f"{name}.npy").file_size
            if size > max_bytes:
                raise TooLarge(f"{self.path}: bytes of {name}", size, max_bytes)
            content = self._archive.read(f"{name}.npy")
        except (KeyError, zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError) as error:
            reason = f"has no {name}" if isinstance(error, KeyError) else f"is damaged: {error}"
            raise NotARun(self.path, reason) from error
        return self._parse(name, content, np.dtype(dtype), shape)

    def _parse(self, name: str, content: bytes, dtype: np.dtype, shape: tuple[int | None, ...]) -> NDArray[Any]:
        body = io.BytesIO(content)
        try:
            if np.lib.format.read_magic(body) != (1, 0):
                raise ValueError("unknown version")
            found, fortran, found_dtype = np.lib.format.read_array_header_1_0(body, max_header_size=4096)
        except ValueError as error:
            raise NotARun(self.path, f"is damaged: {name}: {error}") from error
        fits = len(found) == len(shape) and all(want in (None, n) for want, n in zip(shape, found, strict=True))
        if not fits or fortran or found_dtype != dtype or min(found, default=0) < 0:
            raise NotARun(self.path, f"{name} is {found_dtype} {found}, not {dtype} {shape}")
        if len(content) - body.tell() != math.prod(found) * dtype.itemsize:
            raise NotARun(self.path, f"is damaged: {name} is cut")
        return np.frombuffer(content, dtype, offset=body.tell()).reshape(found).copy()


def read_arrays(path: Path, max_bytes: int = 1 << 30) -> dict[str, NDArray[Any]]:
    """All arrays of an untrusted archive by name, whose sizes together are checked before anything is allocated.

    Raises NotARun for a damaged file or arrays of objects, TooLarge.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > max_bytes:
            raise TooLarge(f"{path}: bytes of arrays", size, max_bytes)
        with np.load(path, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (zipfile.BadZipFile, zlib.error, OSError, ValueError, KeyError, EOFError, NotImplementedError) as error:
        raise NotARun(path, f"is damaged or no .npz: {error}") from error
