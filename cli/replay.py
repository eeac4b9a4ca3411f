"""`quadlog replay`: from recordings to run folders."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quadlog.cli.terminal import parameters
from quadlog.config.controllers import CONTROLLERS, NO_CONTROLLER
from quadlog.errors import UsageError, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quadlog.pipelines.batch.plan import Previewed
    from quadlog.pipelines.request import ReplayOutcome


@click.command(
    name="replay",
    short_help="Replay recordings through all stages, one run folder each.",
    epilog=parameters.examples(
        "quadlog replay walk.mcap -c quadlog.toml",
        "quadlog replay bags/ -c quadlog.toml --jobs 4 --resume",
        "quadlog replay walk.mcap --until map --set grid.cell_m=0.2 -o coarse",
    ),
)
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...", shell_complete=parameters.files())
@parameters.CONFIG
@parameters.set_option("uwb.tag_height_m=0.6")
@click.option("-o", "--output", type=parameters.PATH_OR_URL, default=Path("runs"), help="Folder for the run folders.")
@parameters.START
@parameters.DURATION
@parameters.PRESET
@click.option("--planner", type=parameters.PlannerName(), metavar="NAME", help="Planner, as --set planner.name=NAME.")
@click.option(
    "--controller",
    type=click.Choice([*CONTROLLERS, NO_CONTROLLER]),
    help="Controller, as --set simulation.controller=NAME.",
)
@parameters.UNTIL
@click.option("--jobs", type=click.IntRange(min=1), help="Recordings in parallel. Default: number of cores.")
@parameters.SCHEDULER
@parameters.RESUME
@parameters.FORCE
@parameters.STAMP
@parameters.MSG_PATH
@parameters.seed_option()
@click.option("--no-plots", is_flag=True, help="Do not write plots/*.png.")
@click.option("--dry-run", is_flag=True, help="List what would be replayed, and stop.")
@parameters.AS_JSON
def command(
    recordings: tuple[str, ...],
    config_path: Path | None,
    overrides: tuple[str, ...],
    output: Path,
    preset: str | None,
    planner: str | None,
    controller: str | None,
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
    force: bool,
    no_plots: bool,
    dry_run: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Replay recordings through all stages, one run folder each.

    A RECORDING is a .mcap, .bag or .db3 file, a ROS 2 bag folder, a folder of recordings, or @list.txt.
    """
    if resume and force:
        raise UsageError("--resume and --force exclude each other")
    if scheduler and jobs:
        raise UsageError("--scheduler and --jobs exclude each other: the cluster sets the number of workers")

    from quadlog.cli.terminal.progress_bars import open_batch_progress, open_progress
    from quadlog.config.file import Flag, configure
    from quadlog.pipelines.batch.batch import replay_alone, replay_batch
    from quadlog.pipelines.batch.plan import plan_batch, preview_batch
    from quadlog.pipelines.executor.machine import cores
    from quadlog.pipelines.request import Existing, ReplayOptions

    flags = [
        Flag("--planner", "planner.name", planner),
        Flag("--controller", "simulation.controller", controller),
    ]
    config, notes = configure(config_path, overrides, preset=preset, flags=flags)
    for note in notes:
        click.echo(printable(note), err=True)
    existing = Existing.RESUME if resume else Existing.FORCE if force else Existing.REFUSE

    batch = plan_batch(
        recordings, output, config, ReplayOptions(**options), existing, ("quadlog", *sys.argv[1:]), notes, not no_plots
    )
    if dry_run:
        _print_plan(preview_batch(batch), None if scheduler else jobs or cores(), as_json)
        return 0
    if len(batch) == 1 and scheduler is None:
        with open_progress() as progress:
            outcome = replay_alone(batch[0], progress)
    else:
        with open_batch_progress() as batch_progress:
            outcome = replay_batch(batch, jobs or cores(), scheduler, batch_progress)
    _print_outcomes(outcome.runs, as_json)
    for line in outcome.failure_lines():
        click.echo(printable(line), err=True)
    return outcome.exit_code


def _print_plan(previewed: Sequence[Previewed], jobs: int | None, as_json: bool) -> None:
    rows = [each.to_dict() for each in previewed]
    if as_json:
        click.echo(json.dumps(rows, indent=2))
    for row in () if as_json else rows:
        reused = f", reuses {', '.join(row['reused_stages'])}" if row["reused_stages"] else ""
        size = f"{row['size_bytes'] / 1e6:.1f} MB{reused}"
        click.echo(f"{row['action']:<7} {row['recording']} ({size}) -> {row['run']}")
    click.echo(_total_words(previewed, jobs), err=as_json)


def _total_words(previewed: Sequence[Previewed], jobs: int | None) -> str:
    """The whole batch in one line; the workers of a cluster are unknown, so its time is that of one worker."""
    from quadlog.cli.terminal.progress_bars import duration_words
    from quadlog.pipelines.batch.plan import total_s

    todo = [each for each in previewed if each.expected_s != 0.0]
    words = f"{len(todo)} of {len(previewed)} to replay, {sum(each.planned.size_bytes for each in todo) / 1e6:.1f} MB"
    expected_s = total_s(previewed, jobs or 1)
    if expected_s is None:
        return f"{words}; the duration is unknown until one has been replayed"
    workers = min(jobs or 1, max(1, len(todo)))
    at_a_time = "1 worker" if workers == 1 else f"{workers} workers"
    return f"{words}; about {duration_words(expected_s)} with {at_a_time}"


def _print_outcomes(outcomes: Sequence[ReplayOutcome], as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps([each.to_dict() for each in outcomes], indent=2, allow_nan=False))
        return
    for each in outcomes:
        if each.failed:
            continue  # on stderr, with the reason
        click.echo(f"{each.run}")
        for name, metric in each.metrics.items():
            click.echo(f"  {name:<26} {metric['value']:>14.6g} {metric['unit']:<8} n={metric['n']}")
        click.echo(f"  report: {each.run / 'report.html'}")
