"""A path to walk, from a file: the places of a TUM trajectory, or the columns x_m, y_m of a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.messages import Float
from quadlog.storage.formats.tum import bounded_lines, read_tum

MAX_POINTS = 1_000_000
MAX_BYTES = 256 << 20
_MAX_LINE = 10_000
COLUMNS = ("x_m", "y_m")


def read_path(path: Path) -> Float:
    """The places (K, 2) in map, K >= 1, as they stand in the file.

    A .csv has a header with the columns x_m and y_m, or no header and two columns; lines that start with # and empty
    ones are skipped. Everything else is TUM. Raises UnreadableFile, naming the line, and TooLarge.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise UnreadableFile(path, error.strerror or "cannot be read") from error
    if not path.is_file():
        raise UnreadableFile(path, "is no file")
    if size > MAX_BYTES:
        raise TooLarge(f"{path}: bytes", size, MAX_BYTES)
    if path.suffix.lower() != ".csv":
        return read_tum(path).position_m[:, :2]
    return _read_csv(path)


def _read_csv(path: Path) -> Float:
    points: list[tuple[float, float]] = []
    places: tuple[int, int] | None = None
    width = 0
    for number, cells in _rows(path):
        if places is None:
            width = len(cells)
            if set(COLUMNS) <= set(cells):
                places = cells.index(COLUMNS[0]), cells.index(COLUMNS[1])
                continue
            if width != 2:
                raise UnreadableFile(path, "has neither the columns x_m and y_m nor just two columns", number)
            places = 0, 1
        if len(points) == MAX_POINTS:
            raise TooLarge(f"{path}: points", MAX_POINTS + 1, MAX_POINTS)
        try:
            x_m, y_m = (float(cells[place]) for place in places)
        except (ValueError, IndexError):
            x_m = y_m = float("nan")
        if len(cells) != width or not np.isfinite([x_m, y_m]).all():
            raise UnreadableFile(path, "is not a point x_m, y_m in metres", number)
        points.append((x_m, y_m))
    if not points:
        raise UnreadableFile(path, "holds no point")
    return np.array(points)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that says something."""
    for number, line in bounded_lines(path, _MAX_LINE, "point"):
        try:
            cells = next(csv.reader([line.strip()]))
        except csv.Error:
            raise UnreadableFile(path, "is no line of a CSV file", number) from None
        yield number, [cell.strip() for cell in cells]
