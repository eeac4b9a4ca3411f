"""Arrays from one process of a replay to another, through a file: a pipe takes ten times as long for the same ones."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Compiled code is compiled once more for arrays that do not lie as numpy would lay them.
_ALIGNED_BYTES = 64


@dataclass(frozen=True, slots=True)
class Parcel:
    """A value whose arrays lie in a file, one after the other; how the rest was put is `around`."""

    path: Path
    around: bytes
    lengths: tuple[int, ...]


def pack(value: object, path: Path) -> Parcel:
    """Write the arrays in a value to a file of a folder that is nobody else's. Raises OSError when the disk is full."""
    buffers: list[pickle.PickleBuffer] = []
    around = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    bodies = [each.raw() for each in buffers]
    with path.open("wb") as file:
        for body in bodies:
            file.write(body)
            file.write(bytes(-len(body) % _ALIGNED_BYTES))
    return Parcel(path, around, tuple(len(body) for body in bodies))


def unpack(parcel: Parcel) -> Any:
    """The value again, its arrays in memory of their own; the file is gone then."""
    content = np.fromfile(parcel.path, np.uint8)
    discard(parcel)
    # What another process of this very replay has made.
    return pickle.loads(parcel.around, buffers=_cut(content, parcel.lengths))  # noqa: S301


def discard(parcel: Parcel) -> None:
    """Remove the file of a parcel that nobody wants."""
    with suppress(OSError):
        parcel.path.unlink()


def _cut(content: NDArray[np.uint8], lengths: tuple[int, ...]) -> Iterator[memoryview]:
    begin = 0
    for length in lengths:
        yield content.data[begin : begin + length]
        begin += length + -length % _ALIGNED_BYTES
