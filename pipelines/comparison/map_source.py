"""A map in a file, and starts and goals on it: MovingAI's .map with .scen, or a ROS map_server .yaml."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quadlog.errors import UsageError
from quadlog.map_files.movingai import check_scen, read_movingai_map, read_movingai_scen
from quadlog.map_files.ros_map import read_rosmap
from quadlog.mapping.inflation import INFLATIONS
from quadlog.mapping.window import Window, window_at
from quadlog.pipelines.comparison.source import Episode, Question, Source
from quadlog.planning.protocol import Bool, Cell
from quadlog.planning.query import Query

NO_CELLS = np.empty((0, 2), dtype=np.int32)
Ends = tuple[Cell, Cell]


def movingai_source(path: Path, name: str, scen: Path | None, ends: Ends | None) -> Source:
    """A .map taken raw, its cells 1 m wide: an episode for each line of the .scen, or one from start to goal.

    Raises UnreadableFile, TooLarge, and UsageError when there is nothing to ask.
    """
    blocked = read_movingai_map(path)
    rows, cols = blocked.shape
    about = f"a map of {cols} by {rows} cells, not grown, rows counted from the top, lengths in cells"
    if scen is None:
        return _single(name, f"{about}, one query", blocked, Window(0, 0, 1.0, (rows, cols)), _needed(name, ends), True)
    queries = read_movingai_scen(scen)
    check_scen(queries, (rows, cols), scen)
    if not queries:
        raise UsageError(f"{scen}: holds no query")

    def episodes() -> Iterator[Episode]:
        for query in queries:
            yield [_question(blocked, Window(0, 0, 1.0, (rows, cols)), (query.start, query.goal), blocked)]

    about = f"{about}, {len(queries)} {'query' if len(queries) == 1 else 'queries'} of {scen}"
    return Source(name, about, episodes, len(queries), is_static=True, queries=tuple(queries), row_zero_on_top=True)


def ros_map_source(path: Path, name: str, ends: Ends | None, dilation_m: float, dilation: str) -> Source:
    """A map_server map, its obstacles grown by dilation_m; unknown cells are blocked, and do not grow.

    Cells count from the lower left. Raises UnreadableFile, TooLarge, and UsageError without start and goal.
    """
    ros_map = read_rosmap(path)
    unknown = ros_map.cells < 0
    blocked = INFLATIONS[dilation](ros_map.blocked, dilation_m / ros_map.cell_m) | unknown
    rows, cols = blocked.shape
    about = (
        f"a map of {cols} by {rows} cells of {ros_map.cell_m:g} m, obstacles grown by {dilation_m:g} m ({dilation}), "
        "unknown cells blocked, one query"
    )
    window = window_at(ros_map.origin_m, ros_map.cell_m, blocked.shape)
    return _single(name, about, blocked, window, _needed(name, ends), False, ros_map.blocked | unknown)


def _single(
    name: str, about: str, blocked: Bool, window: Window, ends: Ends, on_top: bool, occupied: Bool | None = None
) -> Source:
    rows, cols = blocked.shape
    for option, (col, row) in zip(("--start-cell", "--goal-cell"), ends, strict=True):
        if not (0 <= col < cols and 0 <= row < rows):
            raise UsageError(f"{option} {col},{row} lies outside {name}, whose cells are 0,0 to {cols - 1},{rows - 1}")
    question = _question(blocked, window, ends, blocked if occupied is None else occupied)
    return Source(name, about, lambda: iter([[question]]), 1, is_static=True, row_zero_on_top=on_top)


def _question(blocked: Bool, window: Window, ends: Ends, occupied: Bool) -> Question:
    return Question(0, Query(window, blocked, ends[0], ends[1], False, NO_CELLS), occupied)


def _needed(name: str, ends: Ends | None) -> Ends:
    if ends is None:
        other = " or --scen FILE.scen" if name.endswith(".map") else ""
        raise UsageError(f"{name}: where from and where to? Give --start-cell COL,ROW and --goal-cell COL,ROW{other}")
    return ends
