"""A run as figures read it: saved files, each read on first use, None where a file is missing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from quadlog.errors import NotARun
from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.results.plots.style import thin_points
from quadlog.results.run.maps import (
    CloudSample,
    DilutionGrid,
    GroundMap,
    MapSequence,
    grid_extent_m,
    load_maps,
    read_cloud_samples,
    read_dilution,
    read_ground,
)
from quadlog.results.run.record import RunRecord
from quadlog.results.run.run_folder import read_metrics, read_run_json
from quadlog.results.run.tables import TABLES, UNBOUNDED, has_table, read_table, start_ns
from quadlog.storage.formats.tum import read_tum

MAX_CELLS = 4_000_000  # of the picture; larger areas are drawn with coarser cells
MAX_MAPS = 1000  # taken evenly from longer sequences
STANDS_M = 1.0  # across; figures of a shorter walk show all that the robot saw
MAX_COORDINATE_CELLS = 1e9  # windows farther out are errors, and would overflow


@dataclass(frozen=True, slots=True)
class Occupancy:
    """share (rows, columns) in 0..1, NaN where no map ever was; row = y, origin_m (2,) the lower-left corner."""

    share: Float
    origin_m: Float
    cell_m: float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """As grid_extent_m."""
        return grid_extent_m(self.origin_m, self.share.shape, self.cell_m)

    @property
    def corners_m(self) -> Float:
        """(2, 2) lower-left and upper-right corner of the cells that were ever occupied; (0, 2) where none was."""
        row, column = np.nonzero(np.nan_to_num(self.share) > 0)
        if not len(row):
            return np.zeros((0, 2))
        cells = np.array([[column.min(), row.min()], [column.max() + 1, row.max() + 1]])
        return self.origin_m + self.cell_m * cells


def seen_around(walked_m: Float, occupancy: Occupancy | None) -> Float:
    """Corners (2, 2) of all that a robot saw whose walk (N, 2) is shorter than STANDS_M; (0, 2) of a longer one."""
    stands = len(walked_m) and np.ptp(walked_m, axis=0).max() < STANDS_M
    return occupancy.corners_m if stands and occupancy is not None else np.zeros((0, 2))


def accumulate(maps: MapSequence) -> Occupancy | None:
    """Occupied / covering maps per cell of the area that all windows cover together; None without maps."""
    sane = np.flatnonzero((np.abs(maps.origin_m) < MAX_COORDINATE_CELLS * maps.cell_m).all(axis=1))
    if not len(sane):
        return None
    chosen = sane[thin_points(len(sane), MAX_MAPS)]
    origin_m = maps.origin_m[chosen].min(axis=0)
    corner = np.rint((maps.origin_m[chosen] - origin_m) / maps.cell_m).astype(np.int64)  # (S, 2) column, row
    rows, columns = (int(size) for size in corner.max(axis=0)[::-1] + np.array(maps.shape))
    coarse = max(1, int(np.ceil(np.sqrt(rows * columns / MAX_CELLS))))
    size = (-(-rows // coarse), -(-columns // coarse))
    occupied, covered = np.zeros(size, np.int64), np.zeros(size, np.int64)
    for index, (column, row) in zip(chosen, corner, strict=True):
        last_row, last_column = (row + maps.shape[0] - 1) // coarse, (column + maps.shape[1] - 1) // coarse
        window = slice(row // coarse, last_row + 1), slice(column // coarse, last_column + 1)
        covered[window] += 1
        if coarse == 1:
            occupied[window] += maps.occupied(int(index))
        else:
            at_row, at_column = np.nonzero(maps.occupied(int(index)))
            occupied.flat[np.unique((at_row + row) // coarse * size[1] + (at_column + column) // coarse)] += 1
    share = np.where(covered > 0, occupied / np.maximum(covered, 1), np.nan)
    return Occupancy(share, origin_m, maps.cell_m * coarse)


Table = dict[str, NDArray[Any]]

LATE_STD = 3.0
REFERENCE_GAP_NS = 1_000_000_000
LARGEST_DRAWN = 1e12
"""Larger numbers are not drawn: no quantity of a run comes near."""


class RunData:
    """A run folder, read lazily. Missing files are None or empty; damaged ones raise NotARun.

    record is for a run whose run.json is not yet written; without it the file is read.
    """

    def __init__(self, path: Path, record: RunRecord | None = None) -> None:
        self.path = path
        self.record = _read_record(path) if record is None else record
        self._tables: dict[str, Table | None] = {}
        self._left_out: dict[str, int] = {}

    def table(self, name: str) -> Table | None:
        """The columns (N,) of NAME.parquet, or None when the file is missing or has no row.

        Rows with a value that cannot be drawn are left out; see left_out.
        """
        if name not in self._tables:
            table = read_table(self.path, name, largest=math.inf) if has_table(self.path, name) else None
            kept = None if table is None else _drawable(table)
            if kept is not None and table is not None and not kept.all():
                self._left_out[name] = int(np.count_nonzero(~kept))
                table = {column: values[kept] for column, values in table.items()}
            self._tables[name] = table if kept is not None and kept.any() else None
        return self._tables[name]

    def left_out(self) -> dict[str, int]:
        """How many rows of each table are not drawn, because a value is beyond LARGEST_DRAWN."""
        for name in TABLES:
            self.table(name)
        return {name: self._left_out[name] for name in TABLES if name in self._left_out}

    @cached_property
    def maps(self) -> MapSequence | None:
        """The map sequence, or None when there is no map."""
        maps = load_maps(self.path) if (self.path / "maps.npz").is_file() else None
        return maps if maps is not None and len(maps) else None

    @cached_property
    def occupancy(self) -> Occupancy | None:
        """All maps as one: in which share of them each cell was occupied; None when there is no map."""
        return accumulate(self.maps) if self.maps is not None else None

    @cached_property
    def cloud_samples(self) -> tuple[list[CloudSample], list[str]]:
        """Sample scans, and the name of each label."""
        return read_cloud_samples(self.path) if (self.path / "cloud_samples.npz").is_file() else ([], [])

    @cached_property
    def ground(self) -> GroundMap | None:
        """The ground's height map, or None."""
        return read_ground(self.path) if (self.path / "ground.npz").is_file() else None

    @cached_property
    def dilution(self) -> DilutionGrid | None:
        """Dilution of precision over the map, or None."""
        return read_dilution(self.path) if (self.path / "dilution.npz").is_file() else None

    @cached_property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """metrics.json: name: {value, n, unit}."""
        return read_metrics(self.path) if (self.path / "metrics.json").is_file() else {}

    def metric(self, name: str) -> float | None:
        """The value of a saved metric, or None."""
        return float(self.metrics[name]["value"]) if name in self.metrics else None

    @cached_property
    def reference_xy_m(self) -> Float | None:
        """Ground truth (N, 2) in map from the recording, or None."""
        path = self.path / "reference.tum"
        return read_tum(path).position_m[:, :2] if path.is_file() else None

    @cached_property
    def pose_error_m(self) -> Float | None:
        """Distance (N,) of each pose to the reference at its instant, NaN where that has none within a second.

        None where the two were not compared: a reference in another frame would be somewhere else.
        """
        path, poses = self.path / "reference.tum", self.table("poses")
        if poses is None or self.metric("ate_rmse_m") is None or not path.is_file():
            return None
        truth = read_tum(path)
        after = np.clip(np.searchsorted(truth.t_ns, poses["t_ns"]), 1, max(len(truth.t_ns) - 1, 1))
        if len(truth.t_ns) < 2:
            return None
        far = truth.t_ns[after] - truth.t_ns[after - 1] > REFERENCE_GAP_NS
        outside = (poses["t_ns"] < truth.t_ns[0]) | (poses["t_ns"] > truth.t_ns[-1])
        seconds, of_truth = seconds_since(poses["t_ns"], self.start_ns), seconds_since(truth.t_ns, self.start_ns)
        x_m, y_m = (np.interp(seconds, of_truth, truth.position_m[:, axis]) for axis in (0, 1))
        return np.where(far | outside, np.nan, np.hypot(poses["x_m"] - x_m, poses["y_m"] - y_m))

    @property
    def simulated(self) -> bool:
        """Whether this is a simulated walk, not the replay of a recording."""
        return "course" in self.record.options

    def anchors(self) -> list[tuple[int, float, float]]:
        """(id, x_m, y_m) of the anchors in the run's config."""
        try:
            anchors = self.record.config.get("uwb", {}).get("anchors", [])
            return [(int(anchor["id"]), float(anchor["x_m"]), float(anchor["y_m"])) for anchor in anchors]
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise NotARun(self.path / "run.json", f"is damaged: config.uwb.anchors: {error}") from error

    def body_m(self) -> tuple[float, float] | None:
        """Length and width of the robot in the run's config, None where it has none."""
        try:
            robot = self.record.config.get("robot", {})
            return (float(robot["length_m"]), float(robot["width_m"])) if "length_m" in robot else None
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise NotARun(self.path / "run.json", f"is damaged: config.robot: {error}") from error

    def late_beyond_m(self) -> float:
        """A range longer than predicted by more is NLOS: LATE_STD times the configured std of a range."""
        try:
            return LATE_STD * float(self.record.config.get("uwb", {}).get("range_std_m", 0.1))
        except (AttributeError, TypeError, ValueError) as error:
            raise NotARun(self.path / "run.json", f"is damaged: config.uwb.range_std_m: {error}") from error

    @cached_property
    def start_ns(self) -> int:
        """The earliest instant of all tables; 0 s of every time axis."""
        return start_ns(self.path)

    def seconds(self, t_ns: Int) -> Float:
        """Instants (N,) as seconds since the start of the run."""
        return seconds_since(t_ns, self.start_ns)


def _drawable(table: Table) -> NDArray[np.bool_]:
    """Which rows (N,) can be drawn: those without numbers that matplotlib cannot handle."""
    kept = np.ones(len(next(iter(table.values()))), dtype=bool)
    for name, values in table.items():
        if name != "t_ns" and values.dtype.kind in "fi":
            too_large = (values > LARGEST_DRAWN) | (values < -LARGEST_DRAWN)
            kept &= ~too_large | (np.isinf(values) if name in UNBOUNDED else False)
    return kept


def _read_record(path: Path) -> RunRecord:
    """run.json with all fields and types checked. Raises NotARun."""
    content = read_run_json(path)
    try:
        return TypeAdapter(RunRecord).validate_python(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise NotARun(path / "run.json", f"is damaged: {where}: {first['msg']}") from error
