"""`quadlog report`: plots and pages, drawn again from saved results."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import LOCAL_PATH, examples, report_skipped


@click.command(
    name="report",
    short_help="Draw plots and pages again from saved results.",
    epilog=examples(
        "quadlog report runs/walk",
        "quadlog report runs",
        "quadlog report runs/before runs/after --side-by-side -o compare.html",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=LOCAL_PATH)
@click.option("--side-by-side", is_flag=True, help="Show several runs in one page, FILE.")
@click.option("-o", "--output", metavar="FILE", type=LOCAL_PATH, help="Page of --side-by-side, as in compare.html.")
@click.option("--force", is_flag=True, help="Replace FILE. Pages of runs and folders are always replaced.")
def command(runs: tuple[Path, ...], side_by_side: bool, output: Path | None, force: bool) -> int:
    """Draw plots/ and report.html of run folders, or the page of a folder of runs, from saved results.

    With --side-by-side, one page has all runs: their paths in one player, curves over each other, settings that
    differ, the first instants at which results differ, and differences of metrics to the first run. Runs of one
    recording are paired instant by instant, and differences have 95 % intervals.
    """
    from quadlog.errors import UsageError
    from quadlog.pipelines.report import rebuild_reports, write_side_by_side

    if side_by_side:
        if len(runs) < 2:
            raise UsageError("--side-by-side takes two runs or more")
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
