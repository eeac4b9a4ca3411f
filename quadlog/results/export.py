"""Saved results in the formats of other tools: a function and one line in EXPORTERS each. Importing this is cheap."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

from quadlog.errors import NotARun, QuadlogError, UnknownName, csv_cell
from quadlog.storage.atomic_write import new_folder, whole_file, write_whole

if TYPE_CHECKING:
    from quadlog.results.run import Run

Files = Mapping[Path, Callable[[Path], object]]
"""The files of an export, and what writes each of them whole."""


def export_run(run: Path, to: str, output: Path | None = None, force: bool = False, **options: Any) -> list[Path]:
    """Write a run folder in the format `to`; returns the files: `output` (tum, mcap, gif, mp4) or those in it.

    Without an output it is named after the run, in the current folder. Raises UnknownName for an unknown format,
    NotARun when the run is unfinished or lacks the result, AlreadyExists unless `force`, UsageError for an output that
    is a file of a run, QuadlogError without ffmpeg, CannotWrite.
    """
    from quadlog.results.find_runs import refuse_existing
    from quadlog.results.run import load_run

    if to not in EXPORTERS:
        raise UnknownName("format", to, EXPORTERS)
    (find, suffix), loaded = EXPORTERS[to], load_run(run)
    files = find(loaded, output or Path(f"{loaded.path.resolve().name}-{suffix}"), **options)
    for path in files:
        refuse_existing(path, force, [run], recording=to == "mcap")
    for path, write in files.items():
        with new_folder(path.parent):
            write(path)
    return [*files]


def _saved(run: Run, output: Path, names: Mapping[str, str]) -> Files:
    """Files as the run saved them, names: each with its path below the output."""
    for name in names:
        if not run.has(name):
            raise NotARun(run.path, f"has no {name}")
    return {output / to: partial(_copy, run.path / name) for name, to in names.items()}


def _copy(source: Path, path: Path) -> None:
    write_whole(path, source.read_bytes())


def _csv(run: Run, output: Path) -> Files:
    """Every table, numbers in full precision, an empty field where there is no value."""
    from pandas import DataFrame

    from quadlog.results.tables import read_table

    def write(path: Path) -> None:
        # A spreadsheet must not take texts of a recording for formulas.
        columns = read_table(run.path, path.stem).items()
        table = {key: [*map(csv_cell, cells)] if cells.dtype == object else cells for key, cells in columns}
        with whole_file(path) as part:
            DataFrame(table).to_csv(part, index=False, lineterminator="\n")

    return {output / f"{name}.csv": write for name in _tables(run)}


def _tables(run: Run) -> list[str]:
    """Names of the run's tables. Raises NotARun without any."""
    from quadlog.results.tables import TABLES

    if names := [name for name in TABLES if run.has(f"{name}.parquet")]:
        return names
    raise NotARun(run.path, "has no tables")


def _mcap(run: Run, output: Path) -> Files:
    from quadlog.results.foxglove import write_derived

    return {output: partial(write_derived, run)} if _tables(run) else {}


def _film(run: Run, output: Path, to: str) -> Files:
    """The walk from above, at most mpl.MOST_FRAMES frames."""
    from quadlog.results.mpl import film
    from quadlog.results.scenes import walk_scene

    if (scene := walk_scene(run)) is None:
        raise NotARun(run.path, "has no positions to film")
    if to == "mp4" and shutil.which("ffmpeg") is None:
        raise QuadlogError("--to mp4 needs ffmpeg, which is not on PATH: install it, or use --to gif")

    def write(path: Path) -> None:
        with TemporaryDirectory(prefix="quadlog-") as folder:
            film(scene, made := Path(folder, f"film.{to}"))
            _copy(made, path)

    return {output: write}


def _figures(run: Run, output: Path, picture: Literal["png", "pdf", "svg"] = "pdf", width_in: float = 3.5) -> Files:
    """Every figure of the run, for a paper: 8 pt, no titles, width_in inches wide."""
    from quadlog.results.figures import drawings_of
    from quadlog.results.mpl import render

    def write(path: Path) -> None:
        write_whole(path, render(drawings[path.stem], picture, width_in, point_size=8.0))

    if not (drawings := drawings_of(run)):
        raise NotARun(run.path, "has nothing to draw")
    return {output / f"{name}.{picture}": write for name in drawings}


EXPORTERS: dict[str, tuple[Callable[..., Files], str]] = {
    "csv": (_csv, "csv"),
    "figures": (_figures, "figures"),
    "gif": (partial(_film, to="gif"), "walk.gif"),
    "mcap": (_mcap, "derived.mcap"),
    "mp4": (partial(_film, to="mp4"), "walk.mp4"),
    "rosmap": (partial(_saved, names={"map.pgm": "map.pgm", "map.yaml": "map.yaml"}), "rosmap"),
    "tum": (partial(_saved, names={"trajectory.tum": ""}), "trajectory.tum"),
}
"""files(run, output, ...) of each format, and the end of the output's name where none is given."""
