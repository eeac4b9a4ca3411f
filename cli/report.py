"""`quadlog report`: plots and pages, drawn again from saved results."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli import options
from quadlog.cli.progress import report_skipped
from quadlog.errors import UsageError


@options.command("report", "runs/walk", "runs", "runs/before runs/after --side-by-side -o compare.html")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=options.LOCAL_PATH)
@click.option("--side-by-side", is_flag=True, help="Show several runs in one page, FILE.")
@options.output_option("Page of --side-by-side, as in compare.html.", metavar="FILE")
@click.option("--force", is_flag=True, help="Replace FILE. Pages of runs and folders are always replaced.")
def command(runs: tuple[Path, ...], side_by_side: bool, output: Path | None, force: bool) -> int:
    """Draw plots and pages again from saved results.

    These are plots/ and report.html of run folders, and the page of a folder of runs.

    With --side-by-side, one page has all runs: their paths in one player, curves over each other, settings that
    differ, the first instants at which results differ, and differences of metrics to the first run. Runs of one
    recording are paired instant by instant, and differences have 95 % intervals.
    """
    from quadlog.pipelines.evaluation.reports import rebuild_reports, write_side_by_side

    if side_by_side:
        if output is None:
            raise UsageError("--side-by-side needs -o FILE.html")
        click.echo(write_side_by_side(runs, output, force))
        return 0
    if output is not None:
        raise UsageError("-o is the page of --side-by-side; without it each run's page lies in its folder")
    report_skipped(runs)
    for report in rebuild_reports(runs):
        click.echo(report)
    return 0
