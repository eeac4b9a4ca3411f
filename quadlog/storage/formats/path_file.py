"""A path to walk, from a file: the places of a TUM trajectory, or the columns x_m, y_m of a CSV file."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.messages import Float
from quadlog.storage.formats.tum import bounded_lines, read_tum

MAX_POINTS = 1_000_000
_MAX_LINE = 10_000
COLUMNS = ("x_m", "y_m")


def read_path(path: Path) -> Float:
    """The places (K, 2) in map, K >= 1, as they stand in the file.

    A .csv has a header with the columns x_m and y_m, or no header and two columns; lines that start with # and empty
    ones are skipped. Everything else is TUM. Raises UnreadableFile, naming the line, and TooLarge.
    """
    if path.suffix.lower() != ".csv":
        return read_tum(path).position_m[:, :2]
    points: list[list[float]] = []
    header: list[str] = []
    for number, line in bounded_lines(path, _MAX_LINE, "point"):
        cells = [cell.strip() for cell in next(csv.reader([line.strip()]))]
        if not header:
            named = set(COLUMNS) <= set(cells)
            if not named and len(cells) != 2:
                raise UnreadableFile(path, "has neither the columns x_m and y_m nor just two columns", number)
            header = cells if named else [*COLUMNS]
            if named:
                continue
        if len(points) == MAX_POINTS:
            raise TooLarge(f"{path}: points", MAX_POINTS + 1, MAX_POINTS)
        try:
            points.append([float(cells[header.index(name)]) for name in COLUMNS])
        except (ValueError, IndexError):
            cells = []
        if len(cells) != len(header) or not np.isfinite(points[-1]).all():
            raise UnreadableFile(path, "is not a point x_m, y_m in metres", number)
    if not points:
        raise UnreadableFile(path, "holds no point")
    return np.array(points)
