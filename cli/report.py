"""`quadlog report`: plots and pages again, from what a run saved."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="report", short_help="Plots and pages again, from saved results.")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option("--force", is_flag=True, expose_value=False, help="Taken, as by every command that writes; not needed.")
def command(runs: tuple[Path, ...]) -> int:
    """Rebuild plots/ and report.html of run folders, or the page of a folder of runs; nothing is computed again."""
    from quadlog.results.report import write_folder_report, write_report
    from quadlog.results.tables import has_table

    for run in runs:
        write = write_folder_report if has_table(run, "summary") else write_report
        click.echo(write(run))
    return 0
