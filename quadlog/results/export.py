"""Saved results in the formats of other tools: a function and one line in EXPORTERS each. Importing this is cheap."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

from quadlog.errors import CannotWrite, MissingProgram, NotARun, UnknownName, csv_cell
from quadlog.storage.atomic_write import whole_file


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
    from quadlog.results.record import read_record

    if to not in EXPORTERS:
        raise UnknownName("format", to, EXPORTERS)
    read_record(run)  # raises for a run that is not finished
    return EXPORTERS[to].write(run, output, force, **options)


def export_tum(run: Path, output: Path, force: bool) -> list[Path]:
    """The robot's poses as a TUM trajectory; of a simulated walk, which has no poses, its trajectory."""
    import numpy as np

    from quadlog.results.tables import has_table, read_table
    from quadlog.storage.formats.tum import write_tum

    if not has_table(run, "poses"):
        return _copy(run, ["trajectory.tum"], [output], force)
    poses = read_table(run, "poses")
    _prepare([output], force)
    tilt_rad = np.column_stack([poses["roll_rad"], poses["pitch_rad"]])
    write_tum(output, poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"], poses["z_m"], tilt_rad)
    return [output]


def export_csv(run: Path, output: Path, force: bool) -> list[Path]:
    """Every table as `output/NAME.csv`, numbers in full precision, an empty field where there is no value."""
    import pandas as pd

    from quadlog.results.tables import read_table

    names = _tables(run)
    written = [output / f"{name}.csv" for name in names]
    _prepare(written, force)
    for name, path in zip(names, written, strict=True):
        columns = read_table(run, name).items()
        # Texts of a recording must not be taken for formulas by a spreadsheet.
        table = pd.DataFrame(
            {key: [*map(csv_cell, cells)] if cells.dtype == object else cells for key, cells in columns}
        )
        with whole_file(path) as part:
            table.to_csv(part, index=False, lineterminator="\n")
    return written


def export_rosmap(run: Path, output: Path, force: bool) -> list[Path]:
    """`output/map.pgm` and `output/map.yaml`, as the run saved them."""
    return _copy(run, ["map.pgm", "map.yaml"], [output / "map.pgm", output / "map.yaml"], force)


def export_mcap(run: Path, output: Path, force: bool) -> list[Path]:
    """`derived.mcap`, written again from the saved results."""
    from quadlog.results.foxglove import write_derived
    from quadlog.results.run import Run

    _tables(run)
    _prepare([output], force)
    return [write_derived(Run(run), output)]


def export_film(run: Path, output: Path, force: bool, to: Literal["gif", "mp4"]) -> list[Path]:
    """The walk from above as an animated GIF or, with ffmpeg, MP4, at most mpl.MOST_FRAMES frames.

    Raises NotARun for a run without positions, MissingProgram.
    """
    from quadlog.results.mpl import film
    from quadlog.results.run import Run
    from quadlog.results.scenes import walk_scene

    scene = walk_scene(Run(run))
    if scene is None:
        raise NotARun(run, "has no positions to film")
    if to == "mp4" and shutil.which("ffmpeg") is None:
        raise MissingProgram("ffmpeg", "--to mp4", "--to gif")
    _prepare([output], force)
    with TemporaryDirectory(prefix="quadlog-") as folder, whole_file(output) as part:
        made = Path(folder) / f"film.{to}"
        film(scene, made)
        shutil.move(made, part)
    return [output]


def export_figures(
    run: Path, output: Path, force: bool, picture: Literal["png", "pdf", "svg"] = "pdf", width_in: float = 3.5
) -> list[Path]:
    """Every figure of the run as `output/NAME.PICTURE`, for a paper: 8 pt, no titles, width_in inches wide."""
    from quadlog.results.figures import drawings_of
    from quadlog.results.mpl import render
    from quadlog.results.run import Run
    from quadlog.storage.atomic_write import write_whole

    drawings = drawings_of(Run(run))
    written = {output / f"{name}.{picture}": drawing for name, drawing in drawings.items()}
    if not written:
        raise NotARun(run, "has nothing to draw")
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


def _tables(run: Path) -> list[str]:
    """Names of the run's tables. Raises NotARun without any."""
    from quadlog.results.tables import TABLES, has_table

    names = [name for name in TABLES if has_table(run, name)]
    if not names:
        raise NotARun(run, "has no tables")
    return names


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
    """Refuse existing files, and make folders, before anything is written."""
    from quadlog.results.find_runs import refuse_existing

    for path in written:
        refuse_existing(path, force)
    for path in written:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CannotWrite(path, error.strerror or str(error)) from error
