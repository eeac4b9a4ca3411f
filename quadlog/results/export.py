"""Saved results in the formats of other tools: a function and one line in EXPORTERS each. Importing this is cheap."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from quadlog.errors import CannotWrite, NotARun, UnknownName, csv_cell
from quadlog.storage.atomic_write import whole_file

Note = Callable[[str], None]


class Exporter(NamedTuple):
    """write(run, output, force, note) gives the files it wrote, and calls note with what was left out, in a line.

    suffix: end of the output's name where none is given.
    """

    write: Callable[[Path, Path, bool, Note], list[Path]]
    suffix: str


def export_run(run: Path, to: str, output: Path, force: bool = False, note: Note = lambda _words: None) -> list[Path]:
    """Write the run folder `run` in the format `to`; returns the files: `output` (tum, mcap, gif, mp4) or those in it.

    note: called with a line on what was thinned. Raises UnknownName for an unknown format, NotARun when the run is
    unfinished or lacks the result, AlreadyExists unless `force`, UsageError for an output that is a file of a run,
    MissingProgram, CannotWrite.
    """
    from quadlog.results.run.run_folder import read_run_json

    if to not in EXPORTERS:
        raise UnknownName("format", to, EXPORTERS)
    read_run_json(run)  # raises for a run that is not finished
    return EXPORTERS[to].write(run, output, force, note)


def export_tum(run: Path, output: Path, force: bool, _note: Note) -> list[Path]:
    """The robot's poses as a TUM trajectory; of a simulated walk, which has no poses, its trajectory."""
    import numpy as np

    from quadlog.results.run.tables import has_table, read_table
    from quadlog.storage.formats.tum import write_tum

    if not has_table(run, "poses"):
        return _copy(run, ["trajectory.tum"], [output], force)
    poses = read_table(run, "poses")
    _prepare([output], force)
    tilt_rad = np.column_stack([poses["roll_rad"], poses["pitch_rad"]])
    write_tum(output, poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"], poses["z_m"], tilt_rad)
    return [output]


def export_csv(run: Path, output: Path, force: bool, _note: Note) -> list[Path]:
    """Every table as `output/NAME.csv`, numbers in full precision, an empty field where there is no value."""
    import pandas as pd

    from quadlog.results.run.tables import read_table

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


def export_rosmap(run: Path, output: Path, force: bool, _note: Note) -> list[Path]:
    """`output/map.pgm` and `output/map.yaml`, as the run saved them."""
    return _copy(run, ["map.pgm", "map.yaml"], [output / "map.pgm", output / "map.yaml"], force)


def export_mcap(run: Path, output: Path, force: bool, _note: Note) -> list[Path]:
    """`derived.mcap`, written again from the saved results."""
    from quadlog.results.foxglove.derived_mcap import write_derived

    _tables(run)
    _prepare([output], force)
    return [write_derived(run, output)]


def export_gif(run: Path, output: Path, force: bool, note: Note) -> list[Path]:
    """The run from above as an animated GIF."""
    from quadlog.results.player.film import write_gif

    _prepare([output], force)
    with whole_file(output) as part:
        write_gif(run, part, note)
    return [output]


def export_mp4(run: Path, output: Path, force: bool, note: Note) -> list[Path]:
    """The run from above as MP4; needs ffmpeg."""
    from quadlog.results.player.film import write_mp4

    _prepare([output], force)
    with whole_file(output) as part:
        write_mp4(run, part, note)
    return [output]


EXPORTERS = {
    "csv": Exporter(export_csv, "csv"),
    "gif": Exporter(export_gif, "walk.gif"),
    "mcap": Exporter(export_mcap, "derived.mcap"),
    "mp4": Exporter(export_mp4, "walk.mp4"),
    "rosmap": Exporter(export_rosmap, "rosmap"),
    "tum": Exporter(export_tum, "trajectory.tum"),
}


def _tables(run: Path) -> list[str]:
    """Names of the run's tables. Raises NotARun without any."""
    from quadlog.results.run.tables import TABLES, has_table

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
    from quadlog.results.run.outputs import refuse_existing

    for path in written:
        refuse_existing(path, force)
    for path in written:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CannotWrite(path, error.strerror or str(error)) from error
