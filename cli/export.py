"""`quadlog export`: a run's results in the formats of other tools."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import FORCE, LOCAL_PATH, PATH_OR_URL, examples
from quadlog.results.export import EXPORTERS, export_run


@click.command(
    name="export",
    short_help="Write results for evo, pandas, ROS map_server or Foxglove, or as a film.",
    epilog=examples(
        "quadlog export runs/walk --to tum -o walk.tum",
        "quadlog export runs/walk --to rosmap -o map",
        "quadlog export runs/walk --to gif -o walk.gif",
    ),
)
@click.argument("run", type=PATH_OR_URL)
@click.option("--to", type=click.Choice(sorted(EXPORTERS)), required=True, help="Format to write.")
@click.option("-o", "--output", type=LOCAL_PATH, help="File (tum, mcap, gif, mp4) or folder (csv, rosmap) to write.")
@FORCE
def command(run: Path, to: str, output: Path | None, force: bool) -> int:
    """Write the results of the run folder RUN for evo (tum), pandas (csv), ROS map_server (rosmap) or Foxglove (mcap).

    gif and mp4 show the run from above, as the player of its report does: at most 240 frames, faster than real time for
    a long run; what was thinned is said on stderr. mp4 needs ffmpeg on PATH.

    Without -o the result is written to the current folder, named after the run.
    """
    from quadlog.errors import printable
    from quadlog.results.run.find_runs import runs_here

    with runs_here([run]) as (here,):
        target = output or Path(f"{here.resolve().name}-{EXPORTERS[to].suffix}")
        for path in export_run(here, to, target, force, lambda words: click.echo(printable(words), err=True)):
            click.echo(path)
    return 0
