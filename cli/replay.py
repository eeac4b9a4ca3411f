"""`quadlog replay`: from recordings to run folders."""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quadlog.cli.terminal import parameters
from quadlog.config.controllers import CONTROLLERS, NO_CONTROLLER
from quadlog.errors import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quadlog.pipelines.batch.plan import Previewed


@click.command(
    name="replay",
    short_help="Replay recordings through all stages.",
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
@click.option(
    "--planner", type=parameters.PlannerName(), metavar="NAME", help="Planner: astar, ia_star, d_star_lite, …."
)
@parameters.controller_option(*CONTROLLERS, NO_CONTROLLER)
@parameters.UNTIL
@parameters.jobs_option("Recordings")
@parameters.SCHEDULER
@parameters.RESUME
@parameters.FORCE
@parameters.STAMP
@parameters.MSG_PATH
@parameters.seed_option()
@click.option("--no-plots", is_flag=True, help="Write no pictures to plots/.")
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
    """Replay recordings through all stages; print the verdict and the page of each run.

    A RECORDING is a .mcap, .bag or .db3 file, a ROS 2 bag folder, a folder of recordings, or @list.txt. Its results
    are written to OUTPUT/NAME: tables, maps, metrics and report.html.
    """
    existing = parameters.what_exists(resume, force, scheduler, jobs)
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import Flag, configure
    from quadlog.pipelines.batch.batch import replay_alone, replay_batch
    from quadlog.pipelines.batch.plan import plan_batch, preview_batch
    from quadlog.pipelines.executor.machine import cores
    from quadlog.pipelines.request import ReplayOptions

    flags = [
        Flag("--planner", "planner.name", planner),
        Flag("--controller", "simulation.controller", controller),
    ]
    config, notes = configure(config_path, overrides, preset=preset, flags=flags)
    for note in notes:
        click.echo(printable(note), err=True)
    batch = plan_batch(
        recordings, output, config, ReplayOptions(**options), existing, ("quadlog", *sys.argv[1:]), notes, not no_plots
    )
    if dry_run:
        _print_plan(preview_batch(batch), None if scheduler else jobs or cores(), as_json)
        return 0
    with open_progress() as progress:
        if len(batch) == 1 and scheduler is None:
            outcome = replay_alone(batch[0], progress)
        else:
            outcome = replay_batch(batch, jobs or cores(), scheduler, progress)
    if as_json:
        click.echo(json.dumps([each.to_dict() for each in outcome.runs], indent=2, allow_nan=False))
    else:
        _print_verdicts([each.run for each in outcome.runs if not each.failed], in_full=len(batch) == 1)
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


def _print_verdicts(runs: Sequence[Path], in_full: bool) -> None:
    """The status of each run and, in full, its verdict; then the page of the run, or the pages of the folders."""
    from quadlog.results.find_runs import MEASURED, runs_here
    from quadlog.results.page.verdict import status, verdict
    from quadlog.results.run import Run

    for path in runs:
        with runs_here([path], MEASURED) as (here,):
            run = Run(here)
            click.echo(f"{path}: {status(run)[0]}")
            sentences = verdict(run) if in_full else []
        for sentence in sentences:
            click.echo(_folded(printable(f"  {sentence.subject}: {sentence.text}")))
    for folder in dict.fromkeys(path if in_full else path.parent for path in runs):
        click.echo(f"{folder / 'report.html'}")


def _folded(line: str) -> str:
    """The line, in a terminal broken at spaces to its width."""
    if not sys.stdout.isatty():
        return line
    return textwrap.fill(line, shutil.get_terminal_size().columns, subsequent_indent="    ", break_on_hyphens=False)
