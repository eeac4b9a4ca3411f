"""A run folder: its record, tables, arrays, maps and metrics, written by name, and each read on first use.

A run is made beside its place, which it takes when it is complete; the run before stands until then.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal
from weakref import finalize

import numpy as np
import tomli_w
from numpy.typing import NDArray

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, QuadlogError, RunExists, UnknownName
from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int, PoseSeries
from quadlog.recordings.file_names import says_run
from quadlog.results.arrays import ARRAYS, MapSequence, load_maps, read_arrays, write_arrays
from quadlog.results.find_runs import OWN_FILES, OWN_PICTURES, PLOTS, fetch, fetch_runs, is_absent
from quadlog.results.record import RunRecord, SavedMetric, read_metrics, read_record, to_json, write_record
from quadlog.results.tables import TABLES, TIMED, UNBOUNDED, read_table, start_ns, write_table
from quadlog.storage.atomic_write import check_name, new_folder, part_folder, uninterrupted, write_whole, writing
from quadlog.storage.formats.tum import read_tum
from quadlog.storage.remote_path import RemotePath, to_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure
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
        self._trajectories: dict[str, PoseSeries | None] = {}
        self._remote: RemotePath | None = None

    def __repr__(self) -> str:
        from quadlog.results.page.verdict import status

        try:
            words = status(self)[0]
        except QuadlogError as error:
            words = str(error)
        return f"Run {self.path.name}: {words}, {self.record.recorded_s:.4g} s, tables: {', '.join(self.tables)}"

    def _repr_html_(self) -> str:
        """For notebooks: the verdict, the metrics that matter, and the names of the tables."""
        from quadlog.results.page.run_page import cards
        from quadlog.results.page.verdict import status, verdict

        told = [(one.subject, one.text) for one in verdict(self)]
        rows = [(theme, name.text, of.text, of.below) for theme, shown in cards(self) for name, of in shown]
        items = "".join(f"<li><b>{escape(subject)}</b>: {escape(text)}</li>" for subject, text in told)
        lines = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        head = f"<b>{escape(self.title)}</b>: {escape(status(self)[0])}"
        return f"<p>{head}</p><ul>{items}</ul><table>{lines}</table><p>tables: {', '.join(self.tables)}</p>"

    @property
    def tables(self) -> list[str]:
        """Names of the tables that this run has."""
        return [name for name in TABLES if self.has(f"{name}.parquet")]

    def figure(
        self, name: str, width: str = "3.5in", height: str | None = None, font: Literal["sans", "serif"] = "sans"
    ) -> Figure:
        """A figure for a paper, as of `quadlog export --to figures`, of matplotlib. width, height: as in 3.5in or 89mm.

        Raises UnknownName, NotARun for a run without its data, UsageError for no length.
        """
        from quadlog.results.export import figure_of, length_in
        from quadlog.results.mpl import picture_of, styled

        drawing, high_in = figure_of(self, name), None if height is None else length_in(height)
        with styled(8.0, font):
            return picture_of(drawing, length_in(width), 8.0, high_in)

    def has(self, name: str) -> bool:
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

    def table(self, name: str) -> DataFrame | None:
        """NAME.parquet with the further column `seconds`, since the start of the run; None without file or rows.

        Numbers beyond LARGEST_SHOWN are NaN, and noted. Raises NotARun for a damaged file, UnknownName for a table that
        is not in TABLES.
        """
        if name not in self._tables:
            self._tables[name] = self._read_table(name)
        return self._tables[name]

    def _read_table(self, name: str) -> DataFrame | None:
        from pandas import DataFrame

        if name in TABLES and not self.has(f"{name}.parquet"):
            return None
        frame = DataFrame(read_table(self.path, name, largest=math.inf))
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
        return read_arrays(self.path, name) if self.has(f"{name}.npz") else None

    def trajectory(self, name: str) -> PoseSeries | None:
        """The poses of NAME.tum. Raises UnreadableFile."""
        if name not in self._trajectories:
            self._trajectories[name] = read_tum(self.path / f"{name}.tum") if self.has(f"{name}.tum") else None
        return self._trajectories[name]

    @cached_property
    def maps(self) -> MapSequence | None:
        """The map sequence. Raises NotARun, TooLarge."""
        maps = load_maps(self.path) if self.has("maps.npz") else None
        return maps if maps is not None and len(maps) else None

    @cached_property
    def metrics(self) -> dict[str, SavedMetric]:
        """The metrics that apply, by name. Raises NotARun."""
        saved = read_metrics(self.path) if self.has("metrics.json") else {}
        return {name: SavedMetric(**metric) for name, metric in saved.items()}

    def metric(self, name: str) -> float | None:
        """The value of a metric, None where it does not apply."""
        return self.metrics[name].value if name in self.metrics else None

    @cached_property
    def start_ns(self) -> int:
        """The earliest instant of all tables: 0 s of every time axis."""
        for name in TIMED:
            self.has(f"{name}.parquet")
        return start_ns(self.path)

    def seconds(self, t_ns: Int) -> Float:
        """Instants (N,) in seconds since the start of the run."""
        return seconds_since(t_ns, self.start_ns)


def create_run(path: Path, record: RunRecord) -> Run:
    """Begin a run in a new folder: its record, unfinished, then `config.toml`. Raises CannotWrite."""
    write_record(path, record, finished=False)
    config = tomli_w.dumps(record.config.model_dump(exclude_none=True))
    write_whole(path / "config.toml", (_CONFIG_HEADER + config).encode())
    return Run(path, record)


def write_result(run: Run, name: str, content: Mapping[str, Any]) -> None:
    """A table as columns, arrays, or `metrics` (name: {value, n, unit, ...}), under its name in the contract.

    A metric without a finite value does not apply and is left out, and so are ends that are not finite.
    Raises UnknownName, CannotWrite, and ValueError or TypeError for what does not fit.
    """
    if name in TABLES:
        write_table(run.path / f"{name}.parquet", TABLES[name], content)
    elif name in ARRAYS:
        write_arrays(run.path, name, content)
    elif name == "metrics":
        kept = {key: _finite(of) for key, of in content.items() if of["value"] is not None}
        write_whole(run.path / "metrics.json", to_json({key: of for key, of in kept.items() if "value" in of}))
    else:
        raise UnknownName("result", name, [*TABLES, *ARRAYS, "metrics"])


def finish_run(run: Run, record: RunRecord) -> None:
    """Mark the run as complete by its record, the last file. Raises CannotWrite."""
    write_record(run.path, record, finished=True)
    run.record = record


def _finite(metric: Mapping[str, Any]) -> dict[str, Any]:
    """A metric without what is not finite; of an interval both ends or none."""
    found = {key: of for key, of in metric.items() if isinstance(of, str) or math.isfinite(of)}
    ends = {"low", "high"}
    return found if ends <= found.keys() else {key: of for key, of in found.items() if key not in ends}


STORE = ".stages"
"""The folder beside runs that holds results of stages, and what is not complete; no command takes it for a run."""


@contextmanager
def new_run(path: Path, force: bool = False) -> Iterator[Path]:
    """A folder below `.stages` to fill, which becomes the run `path` when the block ends, and vanishes if it fails.

    A run that is replaced, with `force`, stands until then; files in it that are not quadlog's stay. Raises as
    `check_place`, also at the end for a run that came meanwhile, and CannotWrite.
    """
    check_place(path, force)
    try:
        with new_folder(path.parent), part_folder(path.parent / STORE) as part:
            yield part
            with writing(path), uninterrupted():
                check_place(path, force)
                if says_run(path):
                    path.rename(_aside(path))
                for left in filter(lambda entry: is_absent(entry.name), path.glob("*")):
                    left.unlink(missing_ok=True)
                try:
                    part.rename(path)  # in one step, which fails where another process was faster
                finally:
                    settle(path)
    finally:
        with suppress(OSError):
            (path.parent / STORE).rmdir()  # where it holds no results


def check_place(path: Path, replace: bool = False) -> None:
    """Whether a run may be made here.

    Raises RunExists for a run without the flag; CannotWrite if the folder is no run but has files, or is a link, and if
    somebody else's folder is in the way of the old one.
    """
    check_name(path)
    settle(path)
    with writing(path):
        names = {entry.name for entry in path.iterdir()} if path.exists() or path.is_symlink() else set()
    if path.is_symlink() and (replace or not says_run(path)):
        raise CannotWrite(path, "it is a symbolic link, and nothing is made or removed behind one")
    if all(is_absent(name) for name in names):
        return
    if not says_run(path):
        raise CannotWrite(path, "the folder holds other files and is no run of quadlog")
    if not replace:
        raise RunExists(path)
    if _aside(path).exists():
        raise CannotWrite(_aside(path), "it is no run of quadlog; move it away")


def _aside(path: Path) -> Path:
    """Where a run waits while it is replaced."""
    return path.parent / STORE / f"old-{path.name}"


def settle(path: Path) -> None:
    """What is left of a run that was replaced, perhaps until a kill: it comes back where the new one never came.

    Its files that are not quadlog's are moved into the new one, the rest is removed. Raises CannotWrite.
    """
    old = _aside(path)
    with writing(path):
        if says_run(old) and not path.exists():
            old.rename(path)
        if not says_run(old):
            return
        for entry in [*old.glob(f"{PLOTS}/*"), *old.iterdir()]:
            name = entry.relative_to(old)
            own = is_absent(name.name) or str(name) in OWN_FILES | OWN_PICTURES | {PLOTS}
            if not own and not (path / name).exists():
                (path / name).parent.mkdir(exist_ok=True)
                entry.rename(path / name)
        shutil.rmtree(old, ignore_errors=True)
