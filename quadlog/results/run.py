"""A run folder: its record, tables, arrays, maps and metrics, each read on first use."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int, PoseSeries
from quadlog.results.record import RunRecord, read_record
from quadlog.results.saved.find_runs import fetch_runs
from quadlog.results.saved.maps import MapSequence, load_maps, read_cloud_samples, read_dilution, read_ground
from quadlog.results.saved.run_folder import read_metrics
from quadlog.results.saved.tables import TABLES, UNBOUNDED, has_table, read_table, start_ns
from quadlog.storage.formats.tum import read_tum
from quadlog.storage.npz import read_arrays
from quadlog.storage.remote_path import RemotePath, to_path

if TYPE_CHECKING:
    from pandas import DataFrame

_CHECKED = {"cloud_samples": read_cloud_samples, "dilution": read_dilution, "ground": read_ground}
"""Readers that know which arrays a file has, of what types and shapes."""
LARGEST_SHOWN = 1e12
"""No quantity of a run comes near; larger numbers are shown as missing, with a note."""


@dataclass(frozen=True, slots=True)
class SavedMetric:
    """A metric of metrics.json: value, number of samples, unit, 95 % interval, worst sample and its instant."""

    value: float
    n: int = 0
    unit: str = ""
    low: float | None = None
    high: float | None = None
    worst: float | None = None
    worst_t_ns: int | None = None


def load_run(path: Path | str) -> Run:
    """The finished run in a folder, or at a URL, which is copied first; the copy is removed with the Run.

    Raises NotARun if the folder is no run or its record is damaged (damaged tables and maps raise when they are read),
    StorageFailed and TooLarge if the copy fails.
    """
    place = to_path(path)
    if not isinstance(place, RemotePath):
        return Run(place)
    scratch = TemporaryDirectory(prefix="quadlog-")
    run = Run(fetch_runs(place, Path(scratch.name)))
    finalize(run, scratch.cleanup)
    return run


class Run:
    """The results in a run folder. A file that is missing is None; a damaged one raises NotARun.

    path: the folder. record: run.json. notes: what was left out on reading.
    """

    def __init__(self, path: Path | str, record: RunRecord | None = None) -> None:
        """record: of a run that is not finished, whose run.json is written last."""
        self.path = Path(path)
        self.record = read_record(self.path) if record is None else record
        self.notes: list[str] = []
        self._tables: dict[str, DataFrame | None] = {}

    @property
    def config(self) -> Config:
        """The effective configuration."""
        return self.record.config

    @property
    def simulated(self) -> bool:
        """Whether this is a simulated walk along a course, not the replay of a recording."""
        return "course" in self.record.options

    @property
    def title(self) -> str:
        """Name of the recording; of a simulated walk the course, controller and seed."""
        name = self.record.input.path.replace("\\", "/").rstrip("/").rsplit("/", 1)[-1] or self.path.name
        return f"{name}, {self.record.options.get('controller')}, seed {self.record.seed}" if self.simulated else name

    def table(self, name: str, columns: Sequence[str] | None = None) -> DataFrame | None:
        """NAME.parquet with the further column `seconds`, since the start of the run; None without file or rows.

        Raises NotARun for a damaged file, UnknownName for a table or column that is not in TABLES.
        """
        if columns is not None or name not in self._tables:
            table = self._read_table(name, columns)
            if columns is not None:
                return table
            self._tables[name] = table
        return self._tables[name]

    def _read_table(self, name: str, columns: Sequence[str] | None) -> DataFrame | None:
        from pandas import DataFrame

        if name in TABLES and not has_table(self.path, name):
            return None
        frame = DataFrame(read_table(self.path, name, columns, largest=math.inf))
        for column in frame.select_dtypes("float").columns:
            values = frame[column].to_numpy()
            wrong = (np.abs(values) > LARGEST_SHOWN) & (np.isfinite(values) | (column not in UNBOUNDED))
            if wrong.any():
                frame.loc[wrong, column] = np.nan
                self.notes.append(f"{wrong.sum()} values of {name}.{column} beyond {LARGEST_SHOWN:g} are not shown")
        if "t_ns" in frame:
            frame["seconds"] = self.seconds(frame["t_ns"].to_numpy())
        return frame if len(frame) else None

    def arrays(self, name: str) -> dict[str, NDArray[Any]] | None:
        """The arrays of NAME.npz by name. Raises NotARun for a damaged file or arrays that do not fit, TooLarge."""
        path = self.path / f"{name}.npz"
        if not path.is_file():
            return None
        if name in _CHECKED:
            _CHECKED[name](self.path)
        return read_arrays(path)

    def trajectory(self, name: str) -> PoseSeries | None:
        """The poses of NAME.tum. Raises UnreadableFile."""
        path = self.path / f"{name}.tum"
        return read_tum(path) if path.is_file() else None

    @cached_property
    def maps(self) -> MapSequence | None:
        """The map sequence. Raises NotARun, TooLarge."""
        maps = load_maps(self.path) if (self.path / "maps.npz").is_file() else None
        return maps if maps is not None and len(maps) else None

    @cached_property
    def metrics(self) -> dict[str, SavedMetric]:
        """The metrics that apply, by name. Raises NotARun."""
        saved = read_metrics(self.path) if (self.path / "metrics.json").is_file() else {}
        names = SavedMetric.__dataclass_fields__
        return {name: SavedMetric(**{key: of[key] for key in names if key in of}) for name, of in saved.items()}

    def metric(self, name: str) -> float | None:
        """The value of a metric, None where it does not apply."""
        return self.metrics[name].value if name in self.metrics else None

    @cached_property
    def start_ns(self) -> int:
        """The earliest instant of all tables: 0 s of every time axis."""
        return start_ns(self.path)

    def seconds(self, t_ns: Int) -> Float:
        """Instants (N,) in seconds since the start of the run."""
        return seconds_since(t_ns, self.start_ns)

    def __repr__(self) -> str:
        return f"<quadlog run {self.path}>"
