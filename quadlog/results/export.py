"""Saved results in the formats of other tools: a function and one line in EXPORTERS each. Importing this is cheap."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from quadlog.errors import CannotWrite, MissingProgram, NotARun, UnknownName, csv_cell
from quadlog.storage.atomic_write import whole_file, write_whole

if TYPE_CHECKING:
    from quadlog.results.run import Run


class Exporter(NamedTuple):
    """write(run, output, force) returns the files it wrote. suffix: end of the output's name where none is given.

    reads: end of the names of the files of a run that it reads, beside run.json.
    """

    write: Callable[..., list[Path]]
    suffix: str
    reads: tuple[str, ...]


def export_run(run: Path, to: str, output: Path, force: bool = False, **options: Any) -> list[Path]:
    """Write the run folder `run` in the format `to`; returns the files: `output` (tum, mcap, gif, mp4) or those in it.

    Raises UnknownName for an unknown format, NotARun when the run is unfinished or lacks the result, AlreadyExists
    unless `force`, UsageError for an output that is a file of a run, MissingProgram, CannotWrite.
    """
    from quadlog.results.run import Run

    if to not in EXPORTERS:
        raise UnknownName("format", to, EXPORTERS)
    return EXPORTERS[to].write(Run(run), output, force, **options)


def export_tum(run: Run, output: Path, force: bool) -> list[Path]:
    """The robot's poses as a TUM trajectory; of a simulated walk, which has no poses, its trajectory."""
    import numpy as np

    from quadlog.results.tables import has_table, read_table
    from quadlog.storage.formats.tum import write_tum

    if not has_table(run.path, "poses"):
        return _copy(run, {"trajectory.tum": output}, force)
    poses = read_table(run.path, "poses")
    _prepare([output], force)
    tilt_rad = np.column_stack([poses["roll_rad"], poses["pitch_rad"]])
    write_tum(output, poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"], poses["z_m"], tilt_rad)
    return [output]


def export_csv(run: Run, output: Path, force: bool) -> list[Path]:
    """Every table as `output/NAME.csv`, numbers in full precision, an empty field where there is no value."""
    import pandas as pd

    from quadlog.results.tables import read_table

    tables = {name: output / f"{name}.csv" for name in _tables(run)}
    _prepare([*tables.values()], force)
    for name, path in tables.items():
        columns = read_table(run.path, name).items()
        # A spreadsheet must not take texts of a recording for formulas.
        table = {key: [*map(csv_cell, cells)] if cells.dtype == object else cells for key, cells in columns}
        with whole_file(path) as part:
            pd.DataFrame(table).to_csv(part, index=False, lineterminator="\n")
    return [*tables.values()]


def export_rosmap(run: Run, output: Path, force: bool) -> list[Path]:
    """`output/map.pgm` and `output/map.yaml`, as the run saved them."""
    return _copy(run, {name: output / name for name in ("map.pgm", "map.yaml")}, force)


def export_mcap(run: Run, output: Path, force: bool) -> list[Path]:
    """`derived.mcap`, written again from the saved results."""
    from quadlog.results.foxglove import write_derived

    _tables(run)
    _prepare([output], force)
    return [write_derived(run, output)]


def export_film(run: Run, output: Path, force: bool, to: Literal["gif", "mp4"]) -> list[Path]:
    """The walk from above as an animated GIF or, with ffmpeg, MP4, at most mpl.MOST_FRAMES frames.

    Raises NotARun for a run without positions, MissingProgram.
    """
    from quadlog.results.mpl import film
    from quadlog.results.scenes import walk_scene

    scene = walk_scene(run)
    if scene is None:
        raise NotARun(run.path, "has no positions to film")
    if to == "mp4" and shutil.which("ffmpeg") is None:
        raise MissingProgram("ffmpeg", "--to mp4", "--to gif")
    _prepare([output], force)
    with TemporaryDirectory(prefix="quadlog-") as folder, whole_file(output) as part:
        made = Path(folder) / f"film.{to}"
        film(scene, made)
        shutil.move(made, part)
    return [output]


def export_figures(
    run: Run, output: Path, force: bool, picture: Literal["png", "pdf", "svg"] = "pdf", width_in: float = 3.5
) -> list[Path]:
    """Every figure of the run as `output/NAME.PICTURE`, for a paper: 8 pt, no titles, width_in inches wide."""
    from quadlog.results.figures import drawings_of
    from quadlog.results.mpl import render

    written = {output / f"{name}.{picture}": drawing for name, drawing in drawings_of(run).items()}
    if not written:
        raise NotARun(run.path, "has nothing to draw")
    _prepare([*written], force)
    for path, drawing in written.items():
        write_whole(path, render(drawing, picture, width_in, point_size=8.0))
    return [*written]


_ALL = (".parquet", ".npz", ".tum", "metrics.json")
EXPORTERS = {
    "csv": Exporter(export_csv, "csv", (".parquet",)),
    "figures": Exporter(export_figures, "figures", _ALL),
    "gif": Exporter(partial(export_film, to="gif"), "walk.gif", _ALL),
    "mcap": Exporter(export_mcap, "derived.mcap", _ALL),
    "mp4": Exporter(partial(export_film, to="mp4"), "walk.mp4", _ALL),
    "rosmap": Exporter(export_rosmap, "rosmap", ("map.pgm", "map.yaml")),
    "tum": Exporter(export_tum, "trajectory.tum", ("poses.parquet", "trajectory.tum")),
}


def _tables(run: Run) -> list[str]:
    """Names of the run's tables. Raises NotARun without any."""
    from quadlog.results.tables import TABLES, has_table

    names = [name for name in TABLES if has_table(run.path, name)]
    if not names:
        raise NotARun(run.path, "has no tables")
    return names


def _copy(run: Run, written: Mapping[str, Path], force: bool) -> list[Path]:
    for name in written:
        if not (run.path / name).is_file():
            raise NotARun(run.path, f"has no {name}")
    _prepare([*written.values()], force)
    for name, path in written.items():
        with whole_file(path) as part:
            shutil.copyfile(run.path / name, part)
    return [*written.values()]


def _prepare(written: Sequence[Path], force: bool) -> None:
    """Refuse existing files, and make folders, before anything is written."""
    from quadlog.results.find_runs import refuse_existing

    for path in written:
        refuse_existing(path, force)
    for path in written:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CannotWrite(path, error.strerror or str(error)) from error
