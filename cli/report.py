"""`quadlog report`: plots and pages, drawn again from saved results."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import LOCAL_PATH, examples, report_skipped


@click.command(
    name="report",
    short_help="Draw plots and pages again, from saved results.",
    epilog=examples(
        "quadlog report runs/walk",
        "quadlog report runs",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=LOCAL_PATH)
@click.option("--force", is_flag=True, expose_value=False, help="Accepted, but not needed: pages are always replaced.")
def command(runs: tuple[Path, ...]) -> int:
    """Draw plots/ and report.html of run folders, or the page of a folder of runs, from saved results."""
    from quadlog.pipelines.report import rebuild_reports

    report_skipped(runs)
    for report in rebuild_reports(runs):
        click.echo(report)
    return 0
