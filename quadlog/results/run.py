"""A run folder: its record, tables, arrays, maps and metrics, written by name, and each read on first use."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self
from weakref import finalize

import numpy as np
import tomli_w
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.errors import UnknownName
from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int, PoseSeries
from quadlog.results.arrays import ARRAYS, MapSequence, load_maps, read_arrays, write_arrays
from quadlog.results.find_runs import fetch, fetch_runs
from quadlog.results.record import (
    RunRecord,
    SavedMetric,
    read_metrics,
    read_record,
    to_json,
    write_record,
)
from quadlog.results.tables import TABLES, TIMED, UNBOUNDED, read_table, start_ns, write_table
from quadlog.storage.atomic_write import note_complete, write_whole
from quadlog.storage.formats.tum import read_tum
from quadlog.storage.remote_path import RemotePath, to_path

if TYPE_CHECKING:
    from pandas import DataFrame

_CONFIG_HEADER = "# quadlog: the effective config; replay with -c on this file gives the same run\n"
LARGEST_SHOWN = 1e12
"""No quantity of a run comes near; larger numbers are shown as missing, with a note."""


def load_run(path: Path | str) -> Run:
    """The finished run in a folder or at a URL, whose files are copied when they are first read, until the Run goes.

    Raises NotARun if the folder is no run or its record is damaged (damaged tables and maps raise when they are read),
    StorageFailed and TooLarge if a copy fails.
    """
    place = to_path(path)
    if not isinstance(place, RemotePath):
        return Run(place)
    scratch = TemporaryDirectory(prefix="quadlog-")
    run = Run(fetch_runs(place, Path(scratch.name), {"run.json"}))
    run._remote = place
    finalize(run, scratch.cleanup)
    return run


class Run:
    """The results in a run folder. A file that is missing is None; a damaged one raises NotARun.

    path: the folder. record: run.json. notes: what was left out on reading.
    """

    def __init__(self, path: Path | str, record: RunRecord | None = None) -> None:
        """record: of a run that is not finished, which is refused without it. Raises NotARun, UnknownRunFormat."""
        self.path = Path(path)
        self.record = read_record(self.path) if record is None else record
        self.notes: list[str] = []
        self._tables: dict[str, DataFrame | None] = {}
        self._remote: RemotePath | None = None

    @classmethod
    def create(cls, path: Path, record: RunRecord) -> Self:
        """Begin a run in a new folder: its record, unfinished, then `config.toml`. Raises CannotWrite."""
        write_record(path, record, finished=False)
        config = tomli_w.dumps(record.config.model_dump(exclude_none=True))
        write_whole(path / "config.toml", (_CONFIG_HEADER + config).encode())
        return cls(path, record)

    def write(self, name: str, content: Mapping[str, Any]) -> None:
        """A table as columns, arrays, or `metrics` (name: {value, n, unit, ...}), under its name in the contract.

        A metric without a finite value does not apply and is left out, and so are ends that are not finite.
        Raises UnknownName, CannotWrite, and ValueError or TypeError for what does not fit.
        """
        if name in TABLES:
            write_table(self.path / f"{name}.parquet", TABLES[name], content)
        elif name in ARRAYS:
            write_arrays(self.path, name, content)
        elif name == "metrics":
            kept = {key: _finite(of) for key, of in content.items() if of["value"] is not None}
            write_whole(self.path / "metrics.json", to_json({key: of for key, of in kept.items() if "value" in of}))
        else:
            raise UnknownName("result", name, [*TABLES, *ARRAYS, "metrics"])

    def finish(self, record: RunRecord) -> None:
        """Mark the run as complete by its record, the last file. Raises CannotWrite."""
        write_record(self.path, record, finished=True)
        note_complete(self.path / "run.json")
        self.record = record

    def _has(self, name: str) -> bool:
        """Whether there is a file of this name, which is copied first from a URL."""
        here = self.path / name
        if self._remote is not None and not here.is_file() and (self._remote / name).is_file():
            fetch({name: self._remote / name}, self.path)
        return here.is_file()

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

        if name in TABLES and not self._has(f"{name}.parquet"):
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
        """The arrays of NAME.npz by name, as ARRAYS has them. Raises NotARun for damage, TooLarge."""
        return read_arrays(self.path, name) if self._has(f"{name}.npz") else None

    def trajectory(self, name: str) -> PoseSeries | None:
        """The poses of NAME.tum. Raises UnreadableFile."""
        return read_tum(self.path / f"{name}.tum") if self._has(f"{name}.tum") else None

    @cached_property
    def maps(self) -> MapSequence | None:
        """The map sequence. Raises NotARun, TooLarge."""
        maps = load_maps(self.path) if self._has("maps.npz") else None
        return maps if maps is not None and len(maps) else None

    @cached_property
    def metrics(self) -> dict[str, SavedMetric]:
        """The metrics that apply, by name. Raises NotARun."""
        saved = read_metrics(self.path) if self._has("metrics.json") else {}
        return {name: SavedMetric(**metric) for name, metric in saved.items()}

    def metric(self, name: str) -> float | None:
        """The value of a metric, None where it does not apply."""
        return self.metrics[name].value if name in self.metrics else None

    @cached_property
    def start_ns(self) -> int:
        """The earliest instant of all tables: 0 s of every time axis."""
        for name in TIMED:
            self._has(f"{name}.parquet")
        return start_ns(self.path)

    def seconds(self, t_ns: Int) -> Float:
        """Instants (N,) in seconds since the start of the run."""
        return seconds_since(t_ns, self.start_ns)

    def __repr__(self) -> str:
        return f"<quadlog run {self.path}>"


def _finite(metric: Mapping[str, Any]) -> dict[str, Any]:
    """A metric without what is not finite; of an interval both ends or none."""
    found = {key: of for key, of in metric.items() if isinstance(of, str) or math.isfinite(of)}
    return (
        found if {"low", "high"} <= found.keys() else {key: found[key] for key in found if key not in ("low", "high")}
    )
