"""Two runs' files compared that are neither tables nor map sequences: trajectories, grids, samples, pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from quadlog.errors import NotARun, TooLarge
from quadlog.messages import Float
from quadlog.results.differences import ResultDifference, ValueDifference
from quadlog.results.dilution import read_dilution
from quadlog.results.equality import Tolerance
from quadlog.results.samples import read_cloud_samples, read_ground
from quadlog.results.table_diff import Columns, compare_tables
from quadlog.results.table_groups import ArrayRows
from quadlog.results.tum import read_tum
from quadlog.results.value_diff import compare_values, flatten

_MAX_BYTES = 1 << 30
_ORIENTATION = ("qx", "qy", "qz", "qw")


def compare_tum(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """A trajectory, pose by pose. Raises UnreadableFile, TooLarge."""
    columns = ("x_m", "y_m", "z_m", *_ORIENTATION)
    return compare_tables(name, _tum_rows(a / name), _tum_rows(b / name), ("t_ns",), columns, tolerance)


def _tum_rows(path: Path) -> ArrayRows:
    poses = read_tum(path)
    position = dict(zip(("x_m", "y_m", "z_m"), poses.position_m.T, strict=True))
    orientation = dict(zip(_ORIENTATION, poses.quat_xyzw.T, strict=True))
    return ArrayRows({"t_ns": poses.t_ns, **position, **orientation})


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
    """Where the grids lie and, if that is the same, their cells; else cell by cell would compare different ground."""
    if values := compare_values(places[0], places[1], tolerance):
        return ResultDifference(name, values=values)
    columns = [column for column in cells[0] if column not in {"row", "column"}]
    return compare_tables(name, ArrayRows(cells[0]), ArrayRows(cells[1]), ("row", "column"), columns, tolerance)


def _cells(grids: Columns) -> Columns:
    row, column = np.indices(next(iter(grids.values())).shape)
    return {"row": row.ravel(), "column": column.ravel()} | {key: values.ravel() for key, values in grids.items()}


def _grid_place(origin_m: Float, cell_m: float) -> dict[str, float]:
    return {"origin_x_m": float(origin_m[0]), "origin_y_m": float(origin_m[1]), "cell_m": cell_m}


def compare_samples(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """The sampled scans, point by point. Raises NotARun, TooLarge."""
    one, other = _sample_points(a), _sample_points(b)
    return compare_tables(name, one, other, ("t_ns", "point"), ("x_m", "y_m", "z_m", "label"), tolerance)


def _sample_points(run: Path) -> ArrayRows:
    """Every point of the sampled scans, its label as the class's name."""
    samples, classes = read_cloud_samples(run)
    lengths = [len(sample.xyz_m) for sample in samples]
    xyz_m = np.concatenate([np.empty((0, 3), np.float32), *(sample.xyz_m for sample in samples)])
    label = np.concatenate([np.empty(0, np.uint8), *(sample.label for sample in samples)])
    t_ns = np.repeat(np.array([sample.t_ns for sample in samples], np.int64), lengths)
    point = np.concatenate([np.empty(0, np.int64), *(np.arange(length) for length in lengths)])
    x_m, y_m, z_m = xyz_m.T
    named = np.array(classes, object)[label]
    return ArrayRows({"t_ns": t_ns, "point": point, "x_m": x_m, "y_m": y_m, "z_m": z_m, "label": named})


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
    """Numbers and lists of numbers read as JSON, which they are too; all else is text."""
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
