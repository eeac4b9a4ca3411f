"""`quadlog export`: a run's results in the formats of other tools."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import HERE, PLACE, examples

SUFFIX = {"tum": "trajectory.tum", "mcap": "derived.mcap", "csv": "csv", "rosmap": "rosmap"}


@click.command(
    name="export",
    short_help="A run's results for evo, pandas, ROS map_server or Foxglove.",
    epilog=examples(
        "quadlog export runs/walk --to tum -o walk.tum",
        "quadlog export runs/walk --to rosmap -o map",
    ),
)
@click.argument("run", type=PLACE)
@click.option("--to", type=click.Choice(sorted(SUFFIX)), required=True, help="The format.")
@click.option("-o", "--output", type=HERE, help="A file (tum, mcap) or a folder (csv, rosmap).")
@click.option("--force", is_flag=True, help="Replace what is there.")
def command(run: Path, to: str, output: Path | None, force: bool) -> int:
    """Write the results of the run folder RUN for evo (tum), pandas (csv), ROS map_server (rosmap) or Foxglove (mcap).

    Without -o the output goes to the current folder and bears the run's name.
    """
    from quadlog.results.export import export_run
    from quadlog.results.run.find_runs import runs_here

    with runs_here([run]) as (here,):
        for path in export_run(here, to, output or Path(f"{here.resolve().name}-{SUFFIX[to]}"), force):
            click.echo(path)
    return 0
