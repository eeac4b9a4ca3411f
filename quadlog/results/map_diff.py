"""Two map sequences compared: which map differs first, and in how many cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadlog.messages import Int
from quadlog.results.differences import ResultDifference
from quadlog.results.equality import Tolerance
from quadlog.results.maps import MapSequence
from quadlog.results.row_match import match_rows
from quadlog.results.table_diff import ColumnFinding, compare_tables, place_of
from quadlog.results.table_groups import ArrayRows
from quadlog.results.value_diff import compare_values


def compare_maps(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """maps.npz of run folders a and b: cell size, windows, and the cells of the maps of the same instant.

    In the column `cells`, a and b are how many are occupied, apart how many differ. Raises NotARun, TooLarge.
    """
    one, other = MapSequence(a / name), MapSequence(b / name)
    if values := compare_values(_kind(one), _kind(other)):
        return ResultDifference(name, values=values)
    rows = [
        ArrayRows({"t_ns": maps.t_ns, "origin_x_m": maps.origin_m[:, 0], "origin_y_m": maps.origin_m[:, 1]})
        for maps in (one, other)
    ]
    windows = compare_tables(name, rows[0], rows[1], ("t_ns",), ("origin_x_m", "origin_y_m"), tolerance)
    cells = _compare_cells(one, other).difference()
    columns = (*windows.columns, cells) if cells is not None else windows.columns
    return ResultDifference(
        name,
        rows_a=windows.rows_a,
        rows_b=windows.rows_b,
        start_ns=windows.start_ns,
        only_in_a=windows.only_in_a,
        only_in_b=windows.only_in_b,
        columns=columns,
    )


def _kind(maps: MapSequence) -> dict[str, float]:
    return {"cell_m": maps.cell_m, "rows": maps.shape[0], "columns": maps.shape[1]}


def _compare_cells(a: MapSequence, b: MapSequence) -> ColumnFinding:
    """Map by map, two of them in memory; not of windows that lie elsewhere, whose cells are other ground."""
    found = ColumnFinding("cells")
    match = match_rows([a.t_ns], [b.t_ns])
    moved_m = np.abs(a.origin_m[match.a] - b.origin_m[match.b]).max(axis=1, initial=0.0)
    same_window = moved_m < a.cell_m / 2
    keys: dict[str, Int] = {"t_ns": a.t_ns}
    for i, k in zip(match.a[same_window].tolist(), match.b[same_window].tolist(), strict=True):
        one, other = a.occupied(i), b.occupied(k)
        if count := float(np.count_nonzero(one != other)):
            occupied = np.count_nonzero(one), np.count_nonzero(other)
            found.add_found(1, place_of(keys, i), *occupied, count, count)
    return found
