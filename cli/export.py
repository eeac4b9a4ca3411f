"""`quadlog export`: a run's results in the formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.errors import UsageError
from quadlog.results.export import EXPORTERS, export_figures, export_run, length_in


@options.command(
    "export",
    "runs/walk --to tum -o walk.tum",
    "runs/walk --to rosmap -o map",
    "runs/walk --to figures --only uwb_error --font serif",
    "runs/coarse runs/fine --to figures --width 7in",
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=options.PATH_OR_URL)
@click.option("--to", type=click.Choice(sorted([*EXPORTERS, "figures"])), required=True, help="Format to write.")
@options.output_option("File (tum, mcap, gif, mp4) or folder (csv, rosmap, figures) to write.")
@click.option("--only", metavar="NAME,...", help="Figures to write, by name. Default: all.")
@click.option("--format", "picture", type=click.Choice(["pdf", "svg", "png"]), help="Format of figures. Default: pdf.")
@click.option("--width", "width_in", type=length_in, metavar="WIDTH", help="Width of figures. Default: 3.5in.")
@click.option("--height", "height_in", type=length_in, metavar="HEIGHT", help="Height, where panels allow it.")
@click.option("--font", type=click.Choice(["sans", "serif"]), help="Letters of figures. Default: sans.")
@options.FORCE
def command(runs: tuple[Path, ...], to: str, output: Path | None, force: bool, **look: Any) -> int:
    """Write results for other tools, for papers, or as a film.

    tum is for evo, csv for pandas, rosmap for ROS map_server, mcap for Foxglove. figures are those of a run for a
    paper, with 8 pt letters; of several runs, or a folder of runs or of a sweep, those in which they differ, over each
    other; and those of a folder of compare-planners. gif and mp4 show the run from above, at most 240 frames; mp4
    needs ffmpeg.

    Without -o the result is written to the current folder, named after the run folder RUN.
    """
    look = {name: value for name, value in look.items() if value is not None}
    if to == "figures":
        only = [name.strip() for name in look.pop("only", "").split(",") if name.strip()]
        written = export_figures(runs, output, force, only, **look)
    elif look:
        raise UsageError("--only, --format, --width, --height and --font are for  --to figures")
    elif len(runs) > 1:
        raise UsageError(f"--to {to} takes one RUN; several are for  --to figures")
    else:
        written = export_run(runs[0], to, output, force)
    for path in written:
        click.echo(path)
    return 0
