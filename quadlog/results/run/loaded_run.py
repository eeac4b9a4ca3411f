"""A finished run for Python scripts: tables as DataFrames, maps as arrays, each read on first use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from weakref import finalize

from quadlog.errors import NotARun
from quadlog.results.run.find_runs import fetch_runs
from quadlog.results.run.run_folder import read_metrics, read_run_json
from quadlog.results.run.tables import TABLES, has_table, read_table
from quadlog.storage.remote_path import RemotePath, to_path

if TYPE_CHECKING:
    from pandas import DataFrame

    from quadlog.results.run.maps import MapSequence


def load_run(path: Path | str) -> Run:
    """The finished run in a folder; see Run. A run at a URL is copied first; the copy is removed with the Run.

    Raises NotARun if the folder is not a run or its record is damaged (damaged tables and maps raise when they are
    read), StorageFailed and TooLarge if the copy fails.
    """
    place = to_path(path)
    if not isinstance(place, RemotePath):
        return Run(place, read_run_json(place))
    scratch = TemporaryDirectory(prefix="quadlog-")
    here = fetch_runs(place, Path(scratch.name))
    run = Run(here, read_run_json(here))
    finalize(run.tables, scratch.cleanup)
    return run


class Run:
    """The results in a run folder.

    path: the folder. record: `run.json`, with input, topics and why they were chosen, losses, warnings, versions and
    times. tables: name -> pandas DataFrame, see RunTables.
    """

    def __init__(self, path: Path, record: dict[str, Any]) -> None:
        self.path, self.record = path, record
        self.tables = RunTables(path)

    @property
    def config(self) -> dict[str, Any]:
        """The effective configuration by section. Raises NotARun if the record has none."""
        config = self.record.get("config")
        if not isinstance(config, dict):
            raise NotARun(self.path / "run.json", "is damaged: it has no config")
        return config

    @cached_property
    def metrics(self) -> dict[str, float]:
        """Metrics as plain numbers, those that apply; `quadlog.results.read_metrics` has n and units too.

        Raises NotARun.
        """
        return {name: metric["value"] for name, metric in read_metrics(self.path).items()}

    @cached_property
    def maps(self) -> MapSequence:
        """The maps: `t_ns` (S,), `origin_m` (S, 2), `cell_m`; `occupied(i)` is map i, (rows, columns) bool, row = y.

        Iterating gives each with its time and place. Raises NotARun for a run without maps, TooLarge.
        """
        from quadlog.results.run.maps import load_maps

        return load_maps(self.path)

    def __repr__(self) -> str:
        return f"<quadlog run {self.path}: {len(self.tables)} tables, {len(self.metrics)} metrics>"


class RunTables(Mapping[str, "DataFrame"]):
    """The tables of a run by name (`poses`, `plans`, ...).

    Each is read once, on first use. A table that the run does not have raises a KeyError that lists those it has; a
    damaged one raises NotARun.
    """

    def __init__(self, run: Path) -> None:
        self._run = run
        self._read: dict[str, DataFrame] = {}

    def __getitem__(self, name: str) -> DataFrame:
        if name not in self._read:
            if name not in self:
                raise KeyError(f"{name}; {self._run} has: {', '.join(self)}")
            from pandas import DataFrame

            self._read[name] = DataFrame(read_table(self._run, name))
        return self._read[name]

    def __contains__(self, name: object) -> bool:
        return name in TABLES and has_table(self._run, str(name))

    def __iter__(self) -> Iterator[str]:
        return (name for name in TABLES if has_table(self._run, name))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        return f"<tables of {self._run}: {', '.join(self)}>"
