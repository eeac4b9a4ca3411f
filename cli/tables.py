"""`quadlog tables`: measure the tables of the papers again."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress
from quadlog.pipelines.tables import TABLES

if TYPE_CHECKING:
    from quadlog.results.studies.papers import PaperTable

NAMES = textwrap.fill(f"TABLE is any of {', '.join(TABLES)}. Default: all.", 76, break_on_hyphens=False)
HELP = f"""Measure the tables of the papers.

The results are printed beside the papers' values, and written with pictures, as a page, CSV and LaTeX.

\b
{NAMES}
"""


@options.command("tables", "--fast", "planning-1 tracking-5 -o tables", help=HELP)
@click.argument("names", metavar="[TABLE]...", nargs=-1, type=click.Choice(list(TABLES)))
@options.output_option("Folder for report.html, and the files of each table.", "tables")
@click.option("--fast", is_flag=True, help="Use fewer random samples (wider intervals).")
@options.SEED
@options.FORCE
def command(names: tuple[str, ...], output: Path, fast: bool, seed: int, force: bool) -> int:
    """Measure, write and print the tables."""
    from quadlog.pipelines.tables.make_tables import make_tables

    with open_progress() as progress:
        tables = make_tables(names, output, fast=fast, seed=seed, force=force, progress=progress)
    for table in tables:
        click.echo(table_text(table), nl=False)
    click.echo(f"{output / 'report.html'}: every quantity, with pictures and notes")
    return 0


def table_text(table: PaperTable) -> str:
    """The rows that the paper has too; all rows where it has none."""
    from quadlog.results.studies.papers import SHOWN, shown_cells
    from quadlog.results.text import TitledTable, print_tables, terminal_width

    if not table.rows:
        return f"{table.name}: {table.sizes}\n"
    printed = [row for row in table.rows if row.paper is not None or row.reproduces is not None]
    title = f"{table.name}: {table.title}{' (fast run)' if table.fast else ''}"
    rows = [shown_cells(row) for row in printed or table.rows]
    below = f"{table.reproduced}; {len(table.rows)} quantities in all"
    return print_tables([TitledTable(title, SHOWN, rows)], "plain", [below], terminal_width())
