"""`quadlog sweep`: one recording with every combination of some settings, on one page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress, print_json, say, show


@options.command(
    "sweep",
    "walk.mcap --set planner.name=astar,ia_star -o planners",
    "walk.mcap --set grid.dilation_m=0.2,0.3,0.4 --until plan",
    "walk.mcap --set simulation.controller=fpmw,pmw --seeds 5",
)
@click.argument("recording", metavar="RECORDING", type=options.PATH_OR_URL, shell_complete=options.files())
@options.CONFIG
@options.repeated(
    "--set", "overrides", metavar="KEY=VALUE,…", help="Values of a configuration key (grid.cell_m=0.1,0.2)"
)
@options.SEEDS
@options.SEED
@options.output_option("Folder for runs, table and page.", "sweep")
@options.replay_options
def command(recording: Path, output: Path, seeds: int, seed: int, as_json: bool, **given: Any) -> int:
    """Replay a recording with combinations of settings.

    Every combination of the values given by --set is a run folder OUTPUT/KEY=VALUE,…/ without plots and page.
    OUTPUT/report.html compares them, with intervals over the seeds; OUTPUT/sweep.parquet has the numbers. Stages that
    combinations share are computed once. `quadlog report OUTPUT/RUN` makes the plots and the page of one run.

    Commas separate values, except inside brackets and quotes: --set key=[1,2],[3,4].
    """
    existing, jobs, scheduler = options.how_to_run(given)
    if scheduler is None:
        from quadlog.pipelines.executor.pool import prepare_workers

        prepare_workers()
    from quadlog.pipelines.batch.sweep import SweepRequest, make_grid, sweep
    from quadlog.pipelines.executor.machine import cores
    from quadlog.pipelines.request import ReplayOptions
    from quadlog.results.studies.sweep import sweep_text

    path, overrides, preset = map(given.pop, ("config_path", "overrides", "preset"))
    grid = make_grid(path, overrides, range(seed, seed + seeds), preset=preset)
    for note in grid[0].configured.notes:
        say(note)
    request = SweepRequest(recording, output, grid, ReplayOptions(**given), existing, ("quadlog", *sys.argv[1:]))
    with open_progress() as progress:
        rows, ended = sweep(request, jobs or cores(), scheduler, progress)
    if as_json:
        print_json([row.to_dict() for row in rows])
    else:
        show(f"{sweep_text(rows)}\nreport: {output / 'report.html'}")
    for line in ended.failure_lines("runs", "sweep.parquet"):
        say(line)
    return ended.exit_code
