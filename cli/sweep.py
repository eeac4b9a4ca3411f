"""`quadlog sweep`: one recording with every combination of some settings, on one page."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from quadlog.cli.terminal import parameters
from quadlog.errors import printable


@click.command(
    name="sweep",
    short_help="Replay a recording with combinations of settings.",
    epilog=parameters.examples(
        "quadlog sweep walk.mcap --set planner.name=astar,ia_star -o planners",
        "quadlog sweep walk.mcap --set grid.dilation_m=0.2,0.3,0.4 --until plan",
        "quadlog sweep walk.mcap --set simulation.controller=fpmw,pmw --seeds 5",
    ),
)
@click.argument("recording", metavar="RECORDING", type=parameters.PATH_OR_URL, shell_complete=parameters.files())
@parameters.CONFIG
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE,…",
    help="Values of a configuration key (grid.cell_m=0.1,0.2); repeatable.",
)
@parameters.seeds_option("Seeds of each combination.")
@parameters.seed_option("First random seed.")
@click.option(
    "-o", "--output", type=parameters.LOCAL_PATH, default=Path("sweep"), help="Folder for runs, table and page."
)
@parameters.START
@parameters.DURATION
@parameters.PRESET
@parameters.UNTIL
@parameters.jobs_option("Runs")
@parameters.SCHEDULER
@parameters.RESUME
@parameters.FORCE
@parameters.STAMP
@parameters.MSG_PATH
@parameters.AS_JSON
def command(
    recording: Path,
    config_path: Path | None,
    overrides: tuple[str, ...],
    seeds: int,
    seed: int,
    output: Path,
    preset: str | None,
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
    force: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Replay a recording with every combination of the values given by --set.

    Each combination is a run folder OUTPUT/KEY=VALUE,…/. OUTPUT/report.html compares them, with intervals over the
    seeds; OUTPUT/sweep.parquet has the numbers. Stages that combinations share are computed once. `quadlog report
    OUTPUT/RUN` makes the page of one run.

    Commas separate values, except inside brackets and quotes: --set key=[1,2],[3,4].
    """
    existing = parameters.what_exists(resume, force, scheduler, jobs)
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.pipelines.executor.machine import cores
    from quadlog.pipelines.request import ReplayOptions
    from quadlog.pipelines.sweep.grid import make_grid
    from quadlog.pipelines.sweep.sweep import SweepRequest, outcome_of, sweep
    from quadlog.results.sweep import sweep_text

    grid = make_grid(config_path, overrides, range(seed, seed + seeds), preset=preset)
    for note in grid[0].configured.notes:
        click.echo(printable(note), err=True)
    request = SweepRequest(recording, output, grid, ReplayOptions(**options), existing, ("quadlog", *sys.argv[1:]))
    with open_progress() as progress:
        rows = sweep(request, jobs or cores(), scheduler, progress)
    if as_json:
        click.echo(json.dumps([row.to_dict() for row in rows], indent=2, allow_nan=False, default=str))
    else:
        click.echo(sweep_text(rows))
        click.echo(f"report: {output / 'report.html'}")
    ended = outcome_of(rows, request)
    for line in ended.failure_lines("runs", "sweep.parquet"):
        click.echo(printable(line), err=True)
    return ended.exit_code
