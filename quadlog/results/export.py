"""Saved results in the formats of other tools, by name: one function and one line in EXPORTERS each."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from quadlog.errors import AlreadyExists, CannotWrite, NotARun, UnknownName, csv_cell
from quadlog.results.foxglove.derived_mcap import write_derived
from quadlog.results.run.run_folder import read_run_json
from quadlog.results.run.tables import TABLES, has_table, read_table
from quadlog.storage.atomic_write import whole_file
from quadlog.storage.formats.tum import write_tum


def export_run(run: Path, to: str, output: Path, force: bool = False) -> list[Path]:
    """What was written of the run folder `run` as `to`: a file `output` (tum, mcap), or files in it (csv, rosmap).

    Raises UnknownName for a format that EXPORTERS does not have, NotARun when
    the run is not finished or lacks the result, AlreadyExists unless `force`, CannotWrite.
    """
    if to not in EXPORTERS:
        raise UnknownName("format", to, EXPORTERS)
    read_run_json(run)  # one that is not finished holds half of what it will
    return EXPORTERS[to](run, output, force)


def export_tum(run: Path, output: Path, force: bool) -> list[Path]:
    """The robot's poses as a TUM trajectory; a walk along a course has no poses but its trajectory."""
    if not has_table(run, "poses"):
        return _copy(run, ["trajectory.tum"], [output], force)
    poses = read_table(run, "poses", ["t_ns", "x_m", "y_m", "yaw_rad"])
    _prepare([output], force)
    write_tum(output, poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"])
    return [output]


def export_csv(run: Path, output: Path, force: bool) -> list[Path]:
    """Every table as `output/NAME.csv`, numbers in full precision, an empty field where there is no value."""
    import pandas as pd  # half a second, for this one format

    names = [name for name in TABLES if has_table(run, name)]
    if not names:
        raise NotARun(run, "has no tables")
    written = [output / f"{name}.csv" for name in names]
    _prepare(written, force)
    for name, path in zip(names, written, strict=True):
        table = pd.DataFrame({column: _cells(values) for column, values in read_table(run, name).items()})
        with whole_file(path) as part:
            table.to_csv(part, index=False, lineterminator="\n")
    return written


def _cells(values: NDArray[Any]) -> Any:
    """A column as it stands in a CSV file; see csv_cell."""
    return [csv_cell(each) for each in values] if values.dtype == object else values


def export_rosmap(run: Path, output: Path, force: bool) -> list[Path]:
    """`output/map.pgm` and `output/map.yaml`, as the run saved them."""
    return _copy(run, ["map.pgm", "map.yaml"], [output / "map.pgm", output / "map.yaml"], force)


def export_mcap(run: Path, output: Path, force: bool) -> list[Path]:
    """What `derived.mcap` holds, made anew from the saved results."""
    if not any(has_table(run, name) for name in TABLES):
        raise NotARun(run, "has no tables")
    _prepare([output], force)
    return [write_derived(run, output)]


Exporter = Callable[[Path, Path, bool], list[Path]]

EXPORTERS: dict[str, Exporter] = {
    "csv": export_csv,
    "mcap": export_mcap,
    "rosmap": export_rosmap,
    "tum": export_tum,
}


def _copy(run: Path, names: list[str], written: list[Path], force: bool) -> list[Path]:
    for name in names:
        if not (run / name).is_file():
            raise NotARun(run, f"has no {name}")
    _prepare(written, force)
    for name, path in zip(names, written, strict=True):
        with whole_file(path) as part:
            shutil.copyfile(run / name, part)
    return written


def _prepare(written: list[Path], force: bool) -> None:
    """All is refused before anything is written."""
    for path in written:
        if path.exists() and not force:
            raise AlreadyExists(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CannotWrite(path, error.strerror or str(error)) from error
