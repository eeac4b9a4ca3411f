"""`quadlog tables`: the papers' tables, measured again."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from quadlog.cli.terminal.parameters import HERE, SEED, examples
from quadlog.pipelines.tables.registry import TABLES

if TYPE_CHECKING:
    from quadlog.results.papers.table import PaperTable

NAMES = f"TABLE is any of {', '.join(TABLES)}; without one, all of them are made."
HELP = f"""Measure the tables of the papers again: a page README.md, and a CSV file, a LaTeX file and pictures for each.

\b
{textwrap.fill(NAMES, 76, break_on_hyphens=False)}
"""


@click.command(
    name="tables",
    short_help="The papers' tables: what they print beside what quadlog finds.",
    help=HELP,
    epilog=examples(
        "quadlog tables --fast",
        "quadlog tables planning-1 tracking-5 -o tables",
    ),
)
@click.argument("names", metavar="[TABLE]...", nargs=-1, type=click.Choice(list(TABLES)))
@click.option("-o", "--output", type=HERE, default=Path("tables"), help="Folder to write to.")
@click.option("--fast", is_flag=True, help="Fewer draws and wider intervals; the page says so.")
@click.option("--seed", type=SEED, default=0, help="Draws everything random.")
@click.option("--force", is_flag=True, help="Replace what is there, if it would change.")
def command(names: tuple[str, ...], output: Path, fast: bool, seed: int, force: bool) -> int:
    """Make, write and print."""
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.pipelines.tables.make_tables import make_tables

    with open_progress() as progress:
        tables = make_tables(names, output, fast=fast, seed=seed, force=force, progress=progress)
    for table in tables:
        print_table(table)
    click.echo(f"{output / 'README.md'}: every quantity, with pictures and notes")
    return 0


def print_table(table: PaperTable) -> None:
    """What the paper prints of a table, beside ours; all of ours where it prints nothing."""
    from quadlog.results.papers.page import RIGHT, SHOWN, shown_cells

    printed = [row for row in table.rows if row.paper is not None or row.reproduces is not None]
    click.echo(f"{table.name}: {table.title}{' (fast run)' if table.fast else ''}")
    _print_columns([SHOWN, *(shown_cells(row) for row in printed or table.rows)], RIGHT)
    click.echo(f"{table.reproduced}; {len(table.rows)} quantities in all")


def _print_columns(lines: Sequence[Sequence[str]], right: Sequence[str]) -> None:
    header = lines[0]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    for line in lines:
        cells = [
            cell.rjust(width) if name in right else cell.ljust(width)
            for cell, width, name in zip(line, widths, header, strict=True)
        ]
        click.echo("  " + "  ".join(cells).rstrip())
