"""Saved results in the formats of other tools: a function and one line in EXPORTERS each. Importing this is cheap."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from quadlog.errors import NotARun, QuadlogError, UnknownName, UsageError, csv_cell
from quadlog.storage.atomic_write import new_folder, whole_file, write_whole
from quadlog.storage.urls import is_url

if TYPE_CHECKING:
    from quadlog.results.run import Run
    from quadlog.results.view import Drawing

Files = Mapping[Path, Callable[[Path], object]]
"""The files of an export, and what writes each of them whole."""


def export_run(run: Path, to: str, output: Path | None = None, force: bool = False, **options: Any) -> list[Path]:
    """Write a run folder in the format `to`; returns the files: `output` (tum, mcap, gif, mp4) or those in it.

    Without an output it is named after the run, in the current folder. Raises UnknownName for an unknown format,
    NotARun when the run is unfinished or lacks the result, AlreadyExists unless `force`, UsageError for an output that
    is a file of a run, QuadlogError without ffmpeg, CannotWrite.
    """
    from quadlog.results.run import load_run

    if to not in EXPORTERS:
        raise UnknownName("format", to, EXPORTERS)
    find, suffix = EXPORTERS[to]
    loaded = load_run(run)
    if not loaded.tables:
        raise NotARun(run, "has no tables")
    files = find(loaded, output or Path(f"{loaded.path.resolve().name}-{suffix}"), **options)
    return _write(files, [run], force, recording=to == "mcap")


def export_figures(
    sources: Sequence[Path], output: Path | None = None, force: bool = False, only: Sequence[str] = (), **look: Any
) -> list[Path]:
    """Figures for a paper, of one run, of several over each other, or of a comparison of planners; returns the files.

    sources: run folders, folders of runs, or one of compare-planners. look: picture (pdf, svg, png), and width_in,
    height_in and font as of mpl.render. Raises as export_run, and UnknownName for a figure that is not among them.
    """
    from quadlog.results.mpl import render

    drawings = _drawings(sources)
    if unknown := [name for name in only if name not in drawings]:
        raise UnknownName("figure", unknown[0], drawings)
    drawings = {name: drawings[name] for name in only or drawings}
    picture = look.pop("picture", "pdf")
    folder = output or Path(f"{sources[0].resolve().name}-figures")

    def write(path: Path) -> None:
        write_whole(path, render(drawings[path.stem], picture, **{"width_in": 3.5, "point_size": 8.0, **look}))

    return _write({folder / f"{name}.{picture}": write for name in drawings}, sources, force)


def length_in(text: str) -> float:
    """A length in inches, centimetres or millimetres, as inches between 1 and 20. Raises UsageError."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(in|cm|mm)", text.strip())
    inches = 0.0 if match is None else float(match[1]) / {"in": 1.0, "cm": 2.54, "mm": 25.4}[match[2]]
    if not 1 <= inches <= 20:
        raise UsageError(f"{text!r} is no length between 1in and 20in, as in 3.5in or 89mm")
    return inches


def figure_of(run: Run, name: str) -> Drawing:
    """A figure of one run, for a paper. Raises UnknownName, and NotARun for a run without its data."""
    makers = _makers()
    if name not in makers:
        raise UnknownName("figure", name, makers)
    if drawing := makers[name](run):
        return drawing
    raise NotARun(run.path, f"has no data for the figure {name}")


def _makers() -> dict[str, Callable[[Run], Drawing | None]]:
    """What makes each figure of a paper."""
    from quadlog.results.figures import FIGURES
    from quadlog.results.scenes import error_scene

    return {**{figure.name: figure.make for figure in FIGURES}, "error_map": error_scene}


MOST_RUNS = 16
"""In one figure; of a larger sweep only its metrics are drawn."""


def _drawings(sources: Sequence[Path]) -> dict[str, Drawing]:
    """The figures of one run; of several those that differ, and of a sweep its metrics; or of compared planners."""
    from quadlog.results.figures import merged_drawings
    from quadlog.results.find_runs import find_runs, run_labels
    from quadlog.results.page.side_by_side import short_names, sweep_panels
    from quadlog.results.run import load_run

    drawings: dict[str, Drawing] = {}
    if (sources[0] / "planners.parquet").is_file():
        from quadlog.results.studies.planners import saved_figures

        return {**saved_figures(sources[0])}
    if (sources[0] / "sweep.parquet").is_file():
        from quadlog.results.studies.sweep import read_sweep_table, summarise_sweep

        summary = summarise_sweep(read_sweep_table(sources[0]))
        named = zip(summary.varying, sweep_panels(summary), strict=True)
        drawings |= {f"swept_{name}": [panel] for name, panel in named}
    places = [found for path in sources for found in ([path] if is_url(str(path)) else find_runs([path]))]
    if len(places) > MOST_RUNS and not drawings:
        raise UsageError(f"{len(places)} runs in one figure cannot be read: name at most {MOST_RUNS}")
    if len(places) > MOST_RUNS:
        return drawings
    runs = [load_run(place) for place in places]
    if len(runs) == 1:
        drawings |= {name: drawing for name, make in _makers().items() if (drawing := make(runs[0]))}
    else:
        drawings |= merged_drawings(dict(zip(short_names(run_labels(places)), runs, strict=True)))
    if not drawings:
        raise NotARun(places[0], "has nothing to draw")
    return drawings


def _write(files: Files, sources: Sequence[Path], force: bool, recording: bool = False) -> list[Path]:
    from quadlog.results.find_runs import refuse_existing

    for path in files:
        refuse_existing(path, force, sources, recording=recording)
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

    return {output / f"{name}.csv": write for name in run.tables}


def _mcap(run: Run, output: Path) -> Files:
    from quadlog.results.foxglove import write_derived

    return {output: partial(write_derived, run)}


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


EXPORTERS: dict[str, tuple[Callable[..., Files], str]] = {
    "csv": (_csv, "csv"),
    "gif": (partial(_film, to="gif"), "walk.gif"),
    "mcap": (_mcap, "derived.mcap"),
    "mp4": (partial(_film, to="mp4"), "walk.mp4"),
    "rosmap": (partial(_saved, names={"map.pgm": "map.pgm", "map.yaml": "map.yaml"}), "rosmap"),
    "tum": (partial(_saved, names={"trajectory.tum": ""}), "trajectory.tum"),
}
"""files(run, output, ...) of each format, and the end of the output's name where none is given."""
