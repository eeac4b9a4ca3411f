"""`quadlog export`: a run's results in the formats of other tools."""

from __future__ import annotations

import re
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import FORCE, LOCAL_PATH, PATH_OR_URL, examples
from quadlog.results.export import EXPORTERS, export_run


class Width(click.ParamType):
    """A length in inches, centimetres or millimetres, as inches."""

    name = "WIDTH"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Between 1 and 20 inches."""
        match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(in|cm|mm)", str(value).strip())
        inches = 0.0 if match is None else float(match[1]) / {"in": 1.0, "cm": 2.54, "mm": 25.4}[match[2]]
        if not 1 <= inches <= 20:
            self.fail(f"{value!r} is no width between 1in and 20in, as in 3.5in or 89mm", param, ctx)
        return inches


@click.command(
    name="export",
    short_help="Write results for evo, pandas, ROS or Foxglove, or a film.",
    epilog=examples(
        "quadlog export runs/walk --to tum -o walk.tum",
        "quadlog export runs/walk --to rosmap -o map",
        "quadlog export runs/walk --to figures --format pdf --width 3.5in -o figures",
    ),
)
@click.argument("run", type=PATH_OR_URL)
@click.option("--to", type=click.Choice(sorted(EXPORTERS)), required=True, help="Format to write.")
@click.option(
    "-o", "--output", type=LOCAL_PATH, help="File (tum, mcap, gif, mp4) or folder (csv, rosmap, figures) to write."
)
@click.option("--format", "picture", type=click.Choice(["pdf", "svg", "png"]), help="Format of figures. Default: pdf.")
@click.option("--width", type=Width(), help="Width of figures, as in 3.5in or 89mm. Default: 3.5in.")
@FORCE
def command(run: Path, to: str, output: Path | None, picture: str | None, width: float | None, force: bool) -> int:
    """Write the results of the run folder RUN for evo (tum), pandas (csv), ROS map_server (rosmap) or Foxglove (mcap).

    figures are all figures of the run for a paper, with 8 pt letters. gif and mp4 show the run from above, at most 240
    frames; mp4 needs ffmpeg on PATH.

    Without -o the result is written to the current folder, named after the run.
    """
    from quadlog.errors import UsageError
    from quadlog.results.find_runs import files_ending, runs_here

    options = {name: value for name, value in (("picture", picture), ("width_in", width)) if value is not None}
    if options and to != "figures":
        raise UsageError("--format and --width are for  --to figures")
    with runs_here([run], files_ending("run.json", *EXPORTERS[to].reads)) as (here,):
        target = output or Path(f"{here.resolve().name}-{EXPORTERS[to].suffix}")
        for path in export_run(here, to, target, force, **options):
            click.echo(path)
    return 0
