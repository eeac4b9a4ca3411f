"""MovingAI's grid benchmarks: `.map` (the terrain) and `.scen` (queries with the length of their shortest path).

Source: [Sturtevant]. Row 0 is the upper one: y grows downwards, and a cell of a query is (col, row) = (x, y).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import TooLarge, UnreadableFile, clipped
from quadlog.storage.formats.tum import bounded_lines

# The benchmark's largest maps have 1024 x 1024 cells; this holds 8192 x 8192 twice over.
_MAX_CELLS = 1 << 27
_MAX_SIDE = 1 << 16
_MAX_QUERIES = 500_000
_MAX_LINE = 1000

_FREE, _BLOCKED, _UNKNOWN = 0, 1, 2
_TERRAIN = np.full(256, _UNKNOWN, np.uint8)
_TERRAIN[np.frombuffer(b".GS", np.uint8)] = _FREE
_TERRAIN[np.frombuffer(b"@OTW", np.uint8)] = _BLOCKED

_HEADER = re.compile(rb"\s*(?:(type)\s+octile|(height|width)\s+0*([1-9][0-9]{0,8}))\s*")
_WHOLE, _DECIMAL = "([0-9]{1,9})", r"([0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]{1,3})?)"
# Between tabs a map's name may hold blanks; U+FFFD stands for what is no UTF-8.
_QUERY = [
    re.compile(between.join([_WHOLE, name, *[_WHOLE] * 6, _DECIMAL]))
    for between, name in ((" *\t *", "([^\t\ufffd]*[^\t \ufffd])"), ("[ \t]+", "([^\t \ufffd]+)"))
]
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
    for number in (1, 2, 3):
        line = file.readline(_MAX_LINE)
        match = _HEADER.fullmatch(line)
        if not match or (match[1] or match[2]) in sides:
            expected = "'type octile', 'height' and 'width', each once with a whole number above 0"
            raise UnreadableFile(path, f"is no MovingAI map: expected {expected}, not {_shown(line)}", number)
        sides[match[1] or match[2]] = side = int(match[3] or 0)
        if side > _MAX_SIDE:
            raise TooLarge(f"{path}, line {number}: {match[2].decode()}", side, _MAX_SIDE)
    if (line := file.readline(_MAX_LINE)).strip() != b"map":
        raise UnreadableFile(path, f"is no MovingAI map: expected 'map', not {_shown(line)}", 4)
    rows, cols = sides[b"height"], sides[b"width"]
    if rows * cols > _MAX_CELLS:
        raise TooLarge(f"{path}, line 4: cells", rows * cols, _MAX_CELLS)
    return rows, cols


def _shown(line: bytes) -> str:
    return ascii(clipped(line.decode(errors="replace").strip(), 50))


def _read_cells(path: Path, file: BinaryIO, rows: int, cols: int) -> NDArray[np.bool_]:
    longest = rows * (cols + 2) + _MAX_LINE
    content = file.read(longest)
    lines = content.replace(b"\r\n", b"\n").split(b"\n", rows) + [b""] * rows
    for number, line in enumerate(lines[:rows], 5):
        if len(line) != cols:
            raise UnreadableFile(path, f"the row has {len(line)} of {cols} columns", number)
    if lines[rows].strip(b"\r\n") or len(content) == longest:
        raise UnreadableFile(path, f"the map goes on after its {rows} rows", rows + 5)
    terrain = _TERRAIN[np.frombuffer(b"".join(lines[:rows]), np.uint8)].reshape(rows, cols)
    if terrain.max() == _UNKNOWN:
        row, col = divmod(int(terrain.argmax()), cols)
        reason = f"{chr(lines[row][col])!a} in column {col + 1} is not one of . G S (free), @ O T W (blocked)"
        raise UnreadableFile(path, reason, row + 5)
    return terrain == _BLOCKED


def read_movingai_scen(path: Path) -> list[ScenQuery]:
    """The queries of a `.scen` file of version 1 (`1.0`), in its order.

    Fields stand between tabs, so that a map's name may hold blanks, or between
    blanks; empty lines are skipped. Raises UnreadableFile, naming the line, for
    anything else, a cell outside the width and height listed beside it included;
    TooLarge for more than 500 000 queries.
    """
    lines = bounded_lines(path, _MAX_LINE, "query", comments=True)
    number, first = next(lines, (1, ""))
    if not re.fullmatch(r"version[ \t]+1(\.0*)?", first.strip()):
        raise UnreadableFile(path, "is no MovingAI scenario: expected 'version 1'", number)
    queries: list[ScenQuery] = []
    for number, line in lines:
        if len(queries) == _MAX_QUERIES:
            raise TooLarge(f"{path}, line {number}: queries", _MAX_QUERIES + 1, _MAX_QUERIES)
        queries.append(_query(path, number, line.strip(" \t\n")))
    if not queries:
        raise UnreadableFile(path, "holds no query", number)
    return queries


def _query(path: Path, number: int, line: str) -> ScenQuery:
    match = _QUERY[0].fullmatch(line) or _QUERY[1].fullmatch(line)
    if not match or not match[2].isprintable() or not math.isfinite(cost := float(match[9])):
        raise UnreadableFile(path, f"is no query: {_FIELDS}", number)
    bucket, width, height, *ends = map(int, match.group(1, *range(3, 9)))
    if max(ends[0::2]) >= width or max(ends[1::2]) >= height:
        raise UnreadableFile(path, f"start or goal lies outside the {width} x {height} cells it is listed with", number)
    return ScenQuery(bucket, match[2], width, height, (ends[0], ends[1]), (ends[2], ends[3]), cost, number)


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
