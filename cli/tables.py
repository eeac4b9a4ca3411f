"""`quadlog tables`: measure the tables of the papers again."""

from __future__ import annotations

import textwrap
from pathlib import Path

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress, show
from quadlog.pipelines.tables import TABLES

NAMES = textwrap.fill(f"TABLE is any of {', '.join(TABLES)}. Default: all.", 76, break_on_hyphens=False)
HELP = f"""Measure the tables of the papers.

How much of each reproduces is printed; all numbers beside the papers' are written as a page, CSV and LaTeX.

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
        show(f"{table.name}: {table.title}: {table.reproduced if table.rows else table.sizes}")
    show(f"{output / 'report.html'}: every quantity, with pictures and notes")
    return 0
