"""`quadlog export`: a run's results in the formats of other tools."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import FORCE, LOCAL_PATH, PATH_OR_URL, examples
from quadlog.results.export import EXPORTERS, export_run


@click.command(
    name="export",
    short_help="Write results for evo, pandas, ROS map_server or Foxglove.",
    epilog=examples(
        "quadlog export runs/walk --to tum -o walk.tum",
        "quadlog export runs/walk --to rosmap -o map",
    ),
)
@click.argument("run", type=PATH_OR_URL)
@click.option("--to", type=click.Choice(sorted(EXPORTERS)), required=True, help="Format to write.")
@click.option("-o", "--output", type=LOCAL_PATH, help="File (tum, mcap) or folder (csv, rosmap) to write.")
@FORCE
def command(run: Path, to: str, output: Path | None, force: bool) -> int:
    """Write the results of the run folder RUN for evo (tum), pandas (csv), ROS map_server (rosmap) or Foxglove (mcap).

    Without -o the result is written to the current folder, named after the run.
    """
    from quadlog.results.run.find_runs import runs_here

    with runs_here([run]) as (here,):
        for path in export_run(here, to, output or Path(f"{here.resolve().name}-{EXPORTERS[to].suffix}"), force):
            click.echo(path)
    return 0
