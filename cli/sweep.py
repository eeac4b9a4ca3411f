"""`quadlog sweep`: one recording with every combination of some settings, on one page."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from quadlog.cli.terminal import parameters
from quadlog.errors import UsageError, printable

MOST_SEEDS = 1000


@click.command(
    name="sweep",
    short_help="Replay a recording with every combination of some settings, and compare.",
    epilog=parameters.examples(
        "quadlog sweep walk.mcap -c quadlog.toml --set planner.name=astar,ia_star,dijkstra -o planners",
        "quadlog sweep walk.mcap --set grid.dilation_m=0.2,0.3,0.4 --set planner.name=astar,ia_star --until plan",
        "quadlog sweep walk.mcap --set simulation.controller=fpmw,pmw --seeds 5 -o controllers --resume",
    ),
)
@click.argument("recording", metavar="RECORDING", type=parameters.PATH_OR_URL, shell_complete=parameters.files())
@parameters.CONFIG
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE,…",
    help="Values of one key, as in grid.cell_m=0.1,0.2; one value is set in all runs; repeatable.",
)
@click.option("--seeds", type=click.IntRange(1, MOST_SEEDS), default=1, metavar="N", help="Seeds of each combination.")
@parameters.seed_option("First random seed.")
@click.option(
    "-o", "--output", type=parameters.LOCAL_PATH, default=Path("sweep"), help="Folder for runs, table and page."
)
@parameters.START
@parameters.DURATION
@parameters.PRESET
@parameters.UNTIL
@click.option("--jobs", type=click.IntRange(min=1), help="Runs in parallel. Default: number of cores.")
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
    """Replay a recording with every combination of the values of some keys, and compare the runs on one page.

    Each combination is a run folder OUTPUT/KEY=VALUE,…/, with seed=NNN in its name where there are several seeds.
    Stages that combinations share are computed once. OUTPUT/report.html has metrics over values, with intervals over
    the seeds, and all paths on one map; OUTPUT/sweep.parquet has the numbers. Runs have no page of their own:
    `quadlog report OUTPUT/RUN` makes it.

    Commas separate values, except inside brackets and quotes, as in --set key=[1,2],[3,4].
    """
    if resume and force:
        raise UsageError("--resume and --force exclude each other")
    if scheduler and jobs:
        raise UsageError("--scheduler and --jobs exclude each other: the cluster sets the number of workers")

    from quadlog.cli.terminal.progress_bars import open_batch_progress
    from quadlog.pipelines.executor.machine import cores
    from quadlog.pipelines.request import Existing, ReplayOptions
    from quadlog.pipelines.sweep.grid import make_grid
    from quadlog.pipelines.sweep.sweep import SweepRequest, outcome_of, sweep
    from quadlog.results.text.sweep import sweep_text

    grid = make_grid(config_path, overrides, range(seed, seed + seeds), preset=preset)
    for note in grid[0].configured.notes:
        click.echo(printable(note), err=True)
    existing = Existing.RESUME if resume else Existing.FORCE if force else Existing.REFUSE
    request = SweepRequest(recording, output, grid, ReplayOptions(**options), existing, ("quadlog", *sys.argv[1:]))
    with open_batch_progress() as progress:
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
