"""MovingAI's grid benchmarks: `.map` (the terrain) and `.scen` (queries with the length of their shortest path).

Source: [Sturtevant]. Row 0 is the upper one: y grows downwards, and a cell of a query is (col, row) = (x, y).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import TooLarge, UnreadableFile

# The benchmark's largest maps have 1024 x 1024 cells; this holds 8192 x 8192 twice over.
_MAX_CELLS = 1 << 27
_MAX_SIDE = 1 << 16
_MAX_QUERIES = 500_000
_MAX_LINE = 1000
_HEADER_LINES = 4

_FREE, _BLOCKED, _UNKNOWN = 0, 1, 2
_TERRAIN = np.full(256, _UNKNOWN, np.uint8)
_TERRAIN[np.frombuffer(b".GS", np.uint8)] = _FREE
_TERRAIN[np.frombuffer(b"@OTW", np.uint8)] = _BLOCKED

_WHOLE = re.compile(r"[0-9]{1,9}")
_DECIMAL = re.compile(r"[0-9]+(\.[0-9]*)?([eE][+-]?[0-9]{1,3})?")
_FIELDS = "bucket, map, width, height, start x, start y, goal x, goal y, length"


@dataclass(frozen=True, slots=True)
class ScenQuery:
    """One query of a `.scen` file.

    bucket: queries of like length share one; width, height: of the map, in cells.
    start, goal: (col, row), row 0 on top, both inside the map.
    listed_cost: length of the shortest path as the file has it, in cells, with
    straight steps of 1 and diagonal ones of sqrt(2) that cut no corner. Some
    files round it to six significant digits.
    line: where it stands in the file.
    """

    bucket: int
    map_name: str
    width: int
    height: int
    start: tuple[int, int]
    goal: tuple[int, int]
    listed_cost: float
    line: int


def read_movingai_map(path: Path) -> NDArray[np.bool_]:
    """Which cells of a `.map` file are blocked: (rows, cols), row 0 on top.

    `.`, `G` and `S` (swamp) are passable; `@`, `O` (out of bounds), `T` (trees)
    and `W` are blocked. Water can be entered from water only, so it is blocked
    for a start on land; the Grid-Based Path Planning Competition reads
    all seven the same way.

    Raises UnreadableFile, naming the line, for anything that is not a map of
    type octile with exactly the rows and columns it announces; TooLarge, before
    allocating, for more than 2^27 cells or 65 536 rows or columns.
    """
    try:
        with path.open("rb") as file:
            rows, cols = _read_header(path, file)
            return _read_cells(path, file, rows, cols)
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error


def _read_header(path: Path, file: BinaryIO) -> tuple[int, int]:
    """Rows and columns; `type`, `height` and `width` in whatever order, then `map`."""
    sides: dict[bytes, int] = {}
    for number in range(1, _HEADER_LINES):
        key, _, value = b" ".join(file.readline(_MAX_LINE).split()).partition(b" ")
        if key not in {b"type", b"height", b"width"} - sides.keys():
            expected = "'type octile', 'height' and 'width', each once"
            raise UnreadableFile(path, f"is no MovingAI map: expected {expected}", number)
        if key == b"type" and value != b"octile":
            raise UnreadableFile(path, f"type is {value.decode(errors='replace')!a}, expected octile", number)
        if key != b"type" and (not value.isdigit() or len(value) > 9 or int(value) == 0):
            raise UnreadableFile(path, f"{key.decode()} is no whole number above 0", number)
        sides[key] = 0 if key == b"type" else int(value)
        if sides[key] > _MAX_SIDE:
            raise TooLarge(f"{path}, line {number}: {key.decode()}", sides[key], _MAX_SIDE)
    if file.readline(_MAX_LINE).split() != [b"map"]:
        raise UnreadableFile(path, "is no MovingAI map: expected 'map'", _HEADER_LINES)
    rows, cols = sides[b"height"], sides[b"width"]
    if rows * cols > _MAX_CELLS:
        raise TooLarge(f"{path}, line {_HEADER_LINES}: cells", rows * cols, _MAX_CELLS)
    return rows, cols


def _read_cells(path: Path, file: BinaryIO, rows: int, cols: int) -> NDArray[np.bool_]:
    blocked = np.empty((rows, cols), np.bool_)
    for row in range(rows):
        number = _HEADER_LINES + 1 + row
        line = file.readline(cols + 3)  # one more than the row, CR and LF
        if not line:
            raise UnreadableFile(path, f"the map ends after {row} of {rows} rows", number)
        cells = line.removesuffix(b"\n").removesuffix(b"\r")
        if len(cells) != cols:
            has = "more" if len(cells) > cols else f"only {len(cells)}"
            raise UnreadableFile(path, f"the row has {has} of {cols} columns", number)
        terrain = _TERRAIN[np.frombuffer(cells, np.uint8)]
        if terrain.max() == _UNKNOWN:
            col = int(terrain.argmax())
            what = ascii(chr(cells[col]))
            raise UnreadableFile(
                path, f"{what} in column {col + 1} is not one of . G S (free), @ O T W (blocked)", number
            )
        blocked[row] = terrain == _BLOCKED
    rest = file.read(_MAX_LINE)
    after = rest.lstrip(b"\r\n")
    if after or len(rest) == _MAX_LINE:
        number = _HEADER_LINES + 1 + rows + rest[: len(rest) - len(after)].count(b"\n")
        raise UnreadableFile(path, f"the map goes on after its {rows} rows", number)
    return blocked


def read_movingai_scen(path: Path) -> list[ScenQuery]:
    """The queries of a `.scen` file of version 1 (`1.0`), in its order.

    Fields stand between tabs, so that a map's name may hold blanks, or between
    blanks; empty lines are skipped. Raises UnreadableFile, naming the line, for
    anything else, a cell outside the width and height listed beside it included;
    TooLarge for more than 500 000 queries.
    """
    lines = _lines(path)
    number, first = next(lines, (1, ""))
    if not re.fullmatch(r"version[ \t]+1(\.0*)?", first.strip(" \t")):
        raise UnreadableFile(path, "is no MovingAI scenario: expected 'version 1'", number)
    queries: list[ScenQuery] = []
    for number, line in lines:
        if not line.strip(" \t"):
            continue
        if len(queries) == _MAX_QUERIES:
            raise TooLarge(f"{path}, line {number}: queries", _MAX_QUERIES + 1, _MAX_QUERIES)
        queries.append(_query(path, number, line))
    if not queries:
        raise UnreadableFile(path, "holds no query", number)
    return queries


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line, without its end."""
    number = 0
    try:
        with path.open("rb") as file:
            while line := file.readline(_MAX_LINE + 1):
                number += 1
                if len(line) > _MAX_LINE:
                    raise UnreadableFile(path, "is longer than any query", number)
                yield number, line.removesuffix(b"\n").removesuffix(b"\r").decode()
    except UnicodeDecodeError as error:
        raise UnreadableFile(path, "is no UTF-8 text", number) from error
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error


def _query(path: Path, number: int, line: str) -> ScenQuery:
    fields = line.strip(" \t").split("\t")
    if len(fields) != 9:
        fields = re.split(r"[ \t]+", line.strip(" \t"))
    if len(fields) != 9:
        raise UnreadableFile(path, f"has {len(fields)} fields, not the nine of a query: {_FIELDS}", number)
    bucket, name, *cells, cost = (field.strip(" ") for field in fields)
    if not all(map(_WHOLE.fullmatch, [bucket, *cells])) or not (name and name.isprintable()):
        raise UnreadableFile(path, f"is no query: {_FIELDS}", number)
    if not _DECIMAL.fullmatch(cost) or not math.isfinite(float(cost)):
        raise UnreadableFile(path, "the length of the shortest path is no number of 0 or more", number)
    width, height, *ends = map(int, cells)
    if max(ends[0::2]) >= width or max(ends[1::2]) >= height:
        raise UnreadableFile(path, f"start or goal lies outside the {width} x {height} cells it is listed with", number)
    return ScenQuery(int(bucket), name, width, height, (ends[0], ends[1]), (ends[2], ends[3]), float(cost), number)


def check_scen(queries: Sequence[ScenQuery], map_shape: tuple[int, int], path: Path) -> None:
    """Raises UnreadableFile, naming the line of the file `path`, unless all queries are for one map of that shape.

    map_shape: (rows, cols). The benchmark would have a map of another size
    stretched to the one listed; quadlog plans on maps as they are.
    """
    rows, cols = map_shape
    for query in queries:
        if (query.height, query.width) != (rows, cols):
            listed = f"{query.width} x {query.height}"
            raise UnreadableFile(path, f"is for a map of {listed} cells, and the map has {cols} x {rows}", query.line)
        if query.map_name != queries[0].map_name:
            raise UnreadableFile(path, f"is for another map than line {queries[0].line}", query.line)
