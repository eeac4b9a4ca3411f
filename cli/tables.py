"""`quadlog tables`: measure the tables of the papers again."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import click

from quadlog.cli.terminal.parameters import FORCE, LOCAL_PATH, examples, seed_option
from quadlog.pipelines.tables.registry import TABLES

if TYPE_CHECKING:
    from quadlog.results.papers.table import PaperTable

NAMES = f"TABLE is any of {', '.join(TABLES)}. Default: all."
HELP = f"""Measure the tables of the papers again; write README.md, report.html, and CSV, LaTeX and pictures of each.

\b
{textwrap.fill(NAMES, 76, break_on_hyphens=False)}
"""


@click.command(
    name="tables",
    short_help="Measure the papers' tables; print both results side by side.",
    help=HELP,
    epilog=examples(
        "quadlog tables --fast",
        "quadlog tables planning-1 tracking-5 -o tables",
    ),
)
@click.argument("names", metavar="[TABLE]...", nargs=-1, type=click.Choice(list(TABLES)))
@click.option("-o", "--output", type=LOCAL_PATH, default=Path("tables"), help="Folder to write to.")
@click.option("--fast", is_flag=True, help="Fewer random draws, wider intervals.")
@seed_option()
@FORCE
def command(names: tuple[str, ...], output: Path, fast: bool, seed: int, force: bool) -> int:
    """Measure, write and print the tables."""
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.pipelines.tables.make_tables import make_tables

    with open_progress() as progress:
        tables = make_tables(names, output, fast=fast, seed=seed, force=force, progress=progress)
    for table in tables:
        print_table(table)
    click.echo(f"{output / 'report.html'}: every quantity, with pictures and notes")
    return 0


def print_table(table: PaperTable) -> None:
    """Print the rows that the paper has too; all rows where it has none."""
    from quadlog.results.papers.page import RIGHT, SHOWN, shown_cells
    from quadlog.results.text.markup import aligned

    if not table.rows:
        click.echo(f"{table.name}: {table.sizes}")
        return
    printed = [row for row in table.rows if row.paper is not None or row.reproduces is not None]
    click.echo(f"{table.name}: {table.title}{' (fast run)' if table.fast else ''}")
    left = [at for at, name in enumerate(SHOWN) if name not in RIGHT]
    for line in aligned([SHOWN, *(shown_cells(row) for row in printed or table.rows)], left):
        click.echo(f"  {line}")
    click.echo(f"{table.reproduced}; {len(table.rows)} quantities in all")
