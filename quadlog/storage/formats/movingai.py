"""MovingAI's grid benchmarks: `.map` (the terrain) and `.scen` (queries with the length of their shortest path).

Source: [Sturtevant]. Row 0 is the upper one: y grows downwards, and a cell of a query is (col, row) = (x, y).
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import BinaryIO, NamedTuple

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


class ScenQuery(NamedTuple):
    """One query of a `.scen` file.

    start, goal: (col, row), row 0 on top, both inside the map.
    listed_cost: length of the shortest path as the file has it, in cells, with
    straight steps of 1 and diagonal ones of sqrt(2) that cut no corner. Some
    files round it to six significant digits.
    """

    start: tuple[int, int]
    goal: tuple[int, int]
    listed_cost: float


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


def read_movingai_scen(path: Path, map_shape: tuple[int, int]) -> list[ScenQuery]:
    """The queries of a `.scen` file of version 1 (`1.0`), in its order, all for one map of map_shape (rows, cols).

    Fields stand between tabs, so that a map's name may hold blanks, or between
    blanks; empty lines are skipped. Raises UnreadableFile, naming the line, for
    anything else, a cell outside the map included; TooLarge for more than
    500 000 queries. The benchmark would have a map of another size stretched to
    the one listed; quadlog plans on maps as they are.
    """
    lines = bounded_lines(path, _MAX_LINE, "query", comments=True)
    number, first = next(lines, (1, ""))
    if not re.fullmatch(r"version[ \t]+1(\.0*)?", first.strip()):
        raise UnreadableFile(path, "is no MovingAI scenario: expected 'version 1'", number)
    queries, of_map, size = list[ScenQuery](), "", map_shape[::-1]
    for number, line in lines:
        if len(queries) == _MAX_QUERIES:
            raise TooLarge(f"{path}, line {number}: queries", _MAX_QUERIES + 1, _MAX_QUERIES)
        stripped = line.strip(" \t\n")
        match = _QUERY[0].fullmatch(stripped) or _QUERY[1].fullmatch(stripped)
        if not match or not match[2].isprintable() or not math.isfinite(cost := float(match[9])):
            raise UnreadableFile(path, f"is no query: {_FIELDS}", number)
        listed, start, goal = ((int(match[at]), int(match[at + 1])) for at in (3, 5, 7))
        of_map = of_map or match[2]
        if listed != size:
            words = f"is for a map of {listed[0]} x {listed[1]} cells, and the map has {size[0]} x {size[1]}"
            raise UnreadableFile(path, words, number)
        if match[2] != of_map:
            raise UnreadableFile(path, f"is for another map than {clipped(of_map)}", number)
        if max(start[0], goal[0]) >= size[0] or max(start[1], goal[1]) >= size[1]:
            raise UnreadableFile(path, f"start or goal lies outside the {size[0]} x {size[1]} cells", number)
        queries.append(ScenQuery(start, goal, cost))
    if not queries:
        raise UnreadableFile(path, "holds no query", number)
    return queries
