"""`quadlog replay`: from recordings to run folders."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress, print_json, say, show
from quadlog.config.controllers import CONTROLLER_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


@options.command(
    "replay",
    "walk.mcap -c quadlog.toml",
    "bags/ -c quadlog.toml --jobs 4 --resume",
    "walk.mcap --until map --set grid.cell_m=0.2 -o coarse",
)
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...", shell_complete=options.files())
@options.CONFIG
@options.set_option("uwb.tag_height_m=0.6")
@options.output_option("Folder for the run folders.", "runs", type=options.PATH_OR_URL)
@options.planner_option("--planner", help="Planner: astar, ia_star, d_star_lite, ….")
@options.controller_option(CONTROLLER_NAMES)
@options.replay_options
@options.SEED
@options.NO_PLOTS
@click.option("-v", "--verbose", is_flag=True, help="Also print the notes that the page has.")
@click.option("--dry-run", is_flag=True, help="List what would be replayed, and stop.")
def command(
    recordings: tuple[str, ...], output: Path, no_plots: bool, dry_run: bool, as_json: bool, verbose: bool, **given: Any
) -> int:
    """Replay recordings through all stages; print verdicts.

    A RECORDING is a .mcap, .bag or .db3 file, a ROS 2 bag folder, a folder of recordings, or @list.txt. Its results
    are written to OUTPUT/NAME: tables, maps, metrics and report.html.
    """
    existing, jobs, scheduler = options.how_to_run(given)
    from quadlog.pipelines.batch.batch import replay_alone, replay_batch
    from quadlog.pipelines.batch.plan import plan_batch, preview_batch
    from quadlog.pipelines.executor.machine import cores
    from quadlog.pipelines.request import ReplayOptions

    config, notes = options.configured(given, planner="planner.name", controller="simulation.controller")
    typed = ("quadlog", *sys.argv[1:])
    batch = plan_batch(recordings, output, config, ReplayOptions(**given), existing, typed, notes, not no_plots)
    if dry_run:
        _print_plan(preview_batch(batch), {each.run.parent for each in batch}, as_json)
        return 0
    with open_progress(verbose) as progress:
        if len(batch) == 1 and scheduler is None:
            outcome = replay_alone(batch[0], progress)
        else:
            outcome = replay_batch(batch, jobs or cores(), scheduler, progress)
    if as_json:
        print_json([each.to_dict() for each in outcome.runs])
    else:
        _print_verdicts([each.run for each in outcome.runs if not each.failed], in_full=len(batch) == 1)
    for line in outcome.failure_lines():
        say(line)
    return outcome.exit_code


def _print_plan(rows: Sequence[dict[str, Any]], folders: Iterable[Path], as_json: bool) -> None:
    from quadlog.pipelines.store import stored_bytes

    if as_json:
        print_json(rows)
    for row in () if as_json else rows:
        reused, size = ", ".join(row["reused_stages"]), f"{row['size_bytes'] / 1e6:.1f} MB"
        about = f"{size}, reuses {reused}" if reused else size
        click.echo(f"{row['action']:<7} {row['recording']} ({about}) -> {row['run']}")
    todo = [row["size_bytes"] for row in rows if row["action"] not in ("skip", "refuse")]
    click.echo(f"{len(todo)} of {len(rows)} to replay, {sum(todo) / 1e6:.1f} MB", err=as_json)
    if any(row["action"] == "refuse" for row in rows):
        click.echo("refuse: a run exists there; use --resume, --force or another -o", err=as_json)
    for folder in filter(stored_bytes, sorted(folders)):
        size_mb = stored_bytes(folder) / 1e6
        click.echo(f"{folder / '.stages'}: {size_mb:.1f} MB of results, which may be deleted", err=as_json)


def _print_verdicts(runs: Sequence[Path], in_full: bool) -> None:
    """The status of each run and, in full, its verdict; then the page of the run, or the pages of the folders."""
    from quadlog.results.page.verdict import status, verdict
    from quadlog.results.run import load_run

    for path in runs:
        run = load_run(path)
        show(f"{path}: {status(run)[0]}")
        for sentence in verdict(run) if in_full else ():
            show(f"  {sentence.subject}: {sentence.text}")
    for folder in dict.fromkeys(path if in_full else path.parent for path in runs):
        click.echo(f"{folder / 'report.html'}")
