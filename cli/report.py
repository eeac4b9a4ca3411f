"""`quadlog report`: plots and pages again, from what a run saved."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import HERE, examples, say_skipped


@click.command(
    name="report",
    short_help="Plots and pages again, from saved results.",
    epilog=examples(
        "quadlog report runs/walk",
        "quadlog report runs",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=HERE)
@click.option("--force", is_flag=True, expose_value=False, help="Taken, as by every command that writes; not needed.")
def command(runs: tuple[Path, ...]) -> int:
    """Rebuild plots/ and report.html of run folders, or the page of a folder of runs; nothing is computed again."""
    from quadlog.pipelines.report import rebuild_reports

    say_skipped(runs)
    for report in rebuild_reports(runs):
        click.echo(report)
    return 0
