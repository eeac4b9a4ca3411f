"""Comparison of saved files by kind: tables, maps, trajectories, grids, samples, pictures, metrics."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.errors import NotARun, TooLarge
from quadlog.messages import Float
from quadlog.results.compare.differences import (
    ColumnDifference,
    ResultDifference,
    Tolerance,
    ValueDifference,
    compare_values,
    flatten,
)
from quadlog.results.compare.table_diff import Columns, column_difference, compare_tables, match_rows
from quadlog.results.run.maps import MapSequence, read_cloud_samples, read_dilution, read_ground
from quadlog.results.run.run_folder import read_metrics
from quadlog.results.run.tables import TABLES, read_table
from quadlog.storage.formats.tum import read_tum

_MAX_BYTES = 1 << 30
_ORIENTATION = ("qx", "qy", "qz", "qw")


def compare_tum(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """A trajectory, pose by pose. Raises UnreadableFile, TooLarge."""
    columns = ("x_m", "y_m", "z_m", *_ORIENTATION)
    return compare_tables(name, _tum_rows(a / name), _tum_rows(b / name), ("t_ns",), columns, tolerance)


def _tum_rows(path: Path) -> Columns:
    poses = read_tum(path)
    position = dict(zip(("x_m", "y_m", "z_m"), poses.position_m.T, strict=True))
    orientation = dict(zip(_ORIENTATION, poses.quat_xyzw.T, strict=True))
    return {"t_ns": poses.t_ns, **position, **orientation}


def compare_ground(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """The ground's heights, cell by cell. Raises NotARun, TooLarge."""
    one, other = read_ground(a), read_ground(b)
    cells = [_cells({"height_m": each.height_m, "count": each.count}) for each in (one, other)]
    places = [_grid_place(each.origin_m, each.cell_m) for each in (one, other)]
    return _compare_grids(name, cells, places, tolerance)


def compare_dilution(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """The dilution of precision, cell by cell. Raises NotARun, TooLarge."""
    one, other = read_dilution(a), read_dilution(b)
    cells = [_cells({"hdop": each.hdop}) for each in (one, other)]
    places = [_grid_place(each.origin_m, each.cell_m) | {"tag_height_m": each.tag_height_m} for each in (one, other)]
    return _compare_grids(name, cells, places, tolerance)


def _compare_grids(
    name: str, cells: list[Columns], places: list[dict[str, float]], tolerance: Tolerance
) -> ResultDifference:
    """The positions of the grids and, if these are the same, their cells."""
    if values := compare_values(places[0], places[1], tolerance):
        return ResultDifference(name, values=values)
    columns = [column for column in cells[0] if column not in {"row", "column"}]
    return compare_tables(name, cells[0], cells[1], ("row", "column"), columns, tolerance)


def _cells(grids: Columns) -> Columns:
    row, column = np.indices(next(iter(grids.values())).shape)
    return {"row": row.ravel(), "column": column.ravel()} | {key: values.ravel() for key, values in grids.items()}


def _grid_place(origin_m: Float, cell_m: float) -> dict[str, float]:
    return {"origin_x_m": float(origin_m[0]), "origin_y_m": float(origin_m[1]), "cell_m": cell_m}


def compare_samples(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """The sampled scans, point by point. Raises NotARun, TooLarge."""
    one, other = _sample_points(a), _sample_points(b)
    return compare_tables(name, one, other, ("t_ns", "point"), ("x_m", "y_m", "z_m", "label"), tolerance)


def _sample_points(run: Path) -> Columns:
    """Every point of the sampled scans, its label as the class's name."""
    samples, classes = read_cloud_samples(run)
    lengths = [len(sample.xyz_m) for sample in samples]
    xyz_m = np.concatenate([np.empty((0, 3), np.float32), *(sample.xyz_m for sample in samples)])
    label = np.concatenate([np.empty(0, np.uint8), *(sample.label for sample in samples)])
    t_ns = np.repeat(np.array([sample.t_ns for sample in samples], np.int64), lengths)
    point = np.concatenate([np.empty(0, np.int64), *(np.arange(length) for length in lengths)])
    x_m, y_m, z_m = xyz_m.T
    named = np.array(classes, object)[label]
    return {"t_ns": t_ns, "point": point, "x_m": x_m, "y_m": y_m, "z_m": z_m, "label": named}


def compare_picture(name: str, a: Path, b: Path, _: Tolerance) -> ResultDifference:
    """map.pgm: how many bytes, which are cells, differ; no tolerance, since its grey values are classes.

    Raises NotARun, TooLarge.
    """
    one, other = (np.frombuffer(_content(run / name), np.uint8) for run in (a, b))
    if len(one) != len(other):
        return ResultDifference(name, values=(ValueDifference("bytes", len(one), len(other)),))
    count = int(np.count_nonzero(one != other))
    return ResultDifference(name, values=(ValueDifference("bytes", len(one), len(other), count),) if count else ())


def compare_map_yaml(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """map.yaml, as `results.rosmap` writes it, key by key. Raises NotARun, TooLarge."""
    return ResultDifference(name, values=compare_values(_yaml_values(a / name), _yaml_values(b / name), tolerance))


def _yaml_values(path: Path) -> dict[str, object]:
    """Numbers and lists of numbers are parsed as JSON, all else is text."""
    values: dict[str, object] = {}
    for line in _content(path).decode("utf-8", "replace").splitlines():
        key, _, text = line.partition(":")
        try:
            values[key] = json.loads(text)
        except (ValueError, RecursionError):
            values[key] = text.strip()
    return flatten(values)


def _content(path: Path) -> bytes:
    try:
        if (size := path.stat().st_size) > _MAX_BYTES:
            raise TooLarge(f"{path}: bytes", size, _MAX_BYTES)
        return path.read_bytes()
    except OSError as error:
        raise NotARun(path, error.strerror or str(error)) from error


def compare_maps(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """maps.npz of run folders a and b: cell size, windows, and the cells of the maps of the same instant.

    In the column `cells`, a and b are how many are occupied, apart how many differ. Raises NotARun, TooLarge.
    """
    one, other = MapSequence(a / name), MapSequence(b / name)
    if values := compare_values(_kind(one), _kind(other)):
        return ResultDifference(name, values=values)
    rows = [
        {"t_ns": maps.t_ns, "origin_x_m": maps.origin_m[:, 0], "origin_y_m": maps.origin_m[:, 1]}
        for maps in (one, other)
    ]
    windows = compare_tables(name, rows[0], rows[1], ("t_ns",), ("origin_x_m", "origin_y_m"), tolerance)
    cells = _compare_cells(one, other)
    return windows if cells is None else replace(windows, columns=(*windows.columns, cells))


def _kind(maps: MapSequence) -> dict[str, float]:
    return {"cell_m": maps.cell_m, "rows": maps.shape[0], "columns": maps.shape[1]}


def _compare_cells(a: MapSequence, b: MapSequence) -> ColumnDifference | None:
    """Map by map, two in memory at a time; windows at different positions are not compared."""
    match = match_rows("maps.npz", {"t_ns": a.t_ns}, {"t_ns": b.t_ns})
    moved_m = np.abs(a.origin_m[match.a] - b.origin_m[match.b]).max(axis=1, initial=0.0)
    occupied_a, occupied_b, apart = np.zeros((3, len(match.a)), np.int64)
    for row in np.flatnonzero(moved_m < a.cell_m / 2).tolist():
        one, other = a.occupied(int(match.a[row])), b.occupied(int(match.b[row]))
        occupied_a[row], occupied_b[row], apart[row] = map(np.count_nonzero, (one, other, one != other))
    keys: Columns = {"t_ns": a.t_ns[match.a]}
    return column_difference("cells", keys, apart > 0, apart.astype(np.float64), occupied_a, occupied_b)


KEYS: dict[str, tuple[str, ...]] = {
    "fixes": ("t_ns", "tag"),
    "ranges": ("t_ns", "tag", "anchor"),
    "links": ("tag", "anchor"),
    "uwb_errors": ("t_ns", "tag", "source"),
    "paths": ("t_ns", "i"),
    "body": ("body", "speeds", "joint", "phase"),
    "gait": ("body", "speeds"),
    "resim_paths": ("t_ns", "i"),
}
"""Key columns of tables whose key is not t_ns."""


def is_timing(name: str) -> bool:
    """Whether a column or metric is a duration, which differs in every run."""
    return name in {"ms", "us", "realtime_factor"} or name.startswith("us_")


def compare_files(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """The file `name` of run folders a and b, which both have. Raises NotARun, TooLarge, UnreadableFile."""
    stem, _, suffix = name.rpartition(".")
    if suffix == "parquet":
        return _compare_parquet(stem, a, b, tolerance)
    return _COMPARERS[name](name, a, b, tolerance)


def _compare_parquet(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    keys = KEYS.get(name, ("t_ns",))
    columns = [column for column in TABLES[name].names if column not in keys and not is_timing(column)]
    # Numbers too large for other uses are compared, too.
    one, other = (read_table(run, name, largest=math.inf) for run in (a, b))
    return compare_tables(name, one, other, keys, columns, tolerance)


def _compare_metrics(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """Values by name of the metric; if both runs have it, also its `NAME.n` and `NAME.unit`."""
    one, other = (
        {metric: content for metric, content in read_metrics(run).items() if not is_timing(metric)} for run in (a, b)
    )
    both = one.keys() & other.keys()
    return ResultDifference(
        name,
        values=compare_values(_metric_values(one, both), _metric_values(other, both), tolerance),
    )


def _metric_values(metrics: Mapping[str, Mapping[str, Any]], both: Set[str]) -> dict[str, Any]:
    values = {name: metric["value"] for name, metric in metrics.items()}
    return values | {f"{name}.{part}": metrics[name].get(part) for name in both for part in ("n", "unit")}


_COMPARERS: dict[str, Callable[[str, Path, Path, Tolerance], ResultDifference]] = {
    "cloud_samples.npz": compare_samples,
    "dilution.npz": compare_dilution,
    "ground.npz": compare_ground,
    "map.pgm": compare_picture,
    "map.yaml": compare_map_yaml,
    "maps.npz": compare_maps,
    "metrics.json": _compare_metrics,
    "reference.tum": compare_tum,
    "trajectory.tum": compare_tum,
}
