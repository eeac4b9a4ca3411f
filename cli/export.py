"""`quadlog export`: a run's results in the formats of other tools."""

from __future__ import annotations

import re
from pathlib import Path

import click

from quadlog.cli import options
from quadlog.errors import UsageError
from quadlog.results.export import EXPORTERS, export_run


def width_in(text: str) -> float:
    """A length in inches, centimetres or millimetres, as inches between 1 and 20."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(in|cm|mm)", text.strip())
    inches = 0.0 if match is None else float(match[1]) / {"in": 1.0, "cm": 2.54, "mm": 25.4}[match[2]]
    if not 1 <= inches <= 20:
        raise click.BadParameter(f"{text!r} is no width between 1in and 20in, as in 3.5in or 89mm")
    return inches


@options.command(
    "export",
    "runs/walk --to tum -o walk.tum",
    "runs/walk --to rosmap -o map",
    "runs/walk --to figures --format pdf --width 3.5in -o figures",
)
@click.argument("run", type=options.PATH_OR_URL)
@click.option("--to", type=click.Choice(sorted(EXPORTERS)), required=True, help="Format to write.")
@options.output_option("File (tum, mcap, gif, mp4) or folder (csv, rosmap, figures) to write.")
@click.option("--format", "picture", type=click.Choice(["pdf", "svg", "png"]), help="Format of figures. Default: pdf.")
@click.option("--width", type=width_in, metavar="WIDTH", help="Width of figures, as in 89mm. Default: 3.5in.")
@options.FORCE
def command(run: Path, to: str, output: Path | None, picture: str | None, width: float | None, force: bool) -> int:
    """Write results for other tools, for papers, or as a film.

    tum is for evo, csv for pandas, rosmap for ROS map_server, mcap for Foxglove. figures are all figures of the run
    for a paper, with 8 pt letters. gif and mp4 show the run from above, at most 240 frames; mp4 needs ffmpeg.

    Without -o the result is written to the current folder, named after the run folder RUN.
    """
    how = {name: value for name, value in (("picture", picture), ("width_in", width)) if value is not None}
    if how and to != "figures":
        raise UsageError("--format and --width are for  --to figures")
    for path in export_run(run, to, output, force, **how):
        click.echo(path)
    return 0
