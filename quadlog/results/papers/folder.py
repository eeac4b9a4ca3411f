"""The folder of the papers' tables: a CSV, LaTeX and JSON file and a picture for each table, and the page of all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadlog.errors import CannotWrite
from quadlog.results.find_runs import refuse_existing
from quadlog.results.numbers import sig
from quadlog.results.papers.picture import table_picture
from quadlog.results.papers.table import Origin, PaperRow, PaperTable, SavedTable, json_bytes, load_saved
from quadlog.results.text import TitledTable, print_table, print_tables
from quadlog.storage.atomic_write import write_whole

PAGE, SUFFIXES = "report.html", ("csv", "tex", "png", "json")
COLUMNS = ("quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note")
SHOWN = ("quantity", "paper", "ours", "95 % interval", "difference", "reproduces")


def csv_text(table: PaperTable) -> str:
    """All rows in full precision, an empty field where there is no value."""
    rows = [
        (row.quantity, row.paper, row.ours, row.low, row.high, row.difference, row.reproduces or "", row.note)
        for row in table.rows
    ]
    return print_table(COLUMNS, rows, "csv")


def latex_text(table: PaperTable) -> str:
    """A table of each group, without the notes."""
    fast = " (fast run)" if table.fast else ""
    groups = [
        TitledTable(f"{table.title}: {group.title}{fast}", SHOWN, [shown_cells(row) for row in group.rows])
        for group in table.groups
    ]
    return print_tables(groups, "latex", [table.command])


def shown_cells(row: PaperRow) -> tuple[str, ...]:
    """A row as people read it, in the order of SHOWN, with four significant digits."""
    interval = ""
    if row.low is not None and row.high is not None:
        interval = f"{_short(row.low)} to {_short(row.high)}"
    paper, difference = (row.claim, "") if row.claim else (_short(row.paper), _short(row.difference))
    return row.quantity, paper, _short(row.ours), interval, difference, row.reproduces or ""


def _short(value: float | None) -> str:
    return "" if value is None else sig(value, 4)


def prepare_folder(folder: Path, names: Sequence[str], force: bool) -> None:
    """Make the folder, before the named tables are measured.

    Raises CannotWrite, and unless `force` AlreadyExists for the page and for a file of theirs.
    """
    for path in [PAGE, *(f"{name}.{suffix}" for name in names for suffix in SUFFIXES)] if names else []:
        refuse_existing(folder / path, force)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error


def write_table(folder: Path, saved: SavedTable) -> None:
    """Write the files of a table; its JSON file last, since it marks the others as complete."""
    table, name = saved.table, saved.table.name
    files = (csv_text(table).encode(), latex_text(table).encode(), table_picture(table), json_bytes(saved))
    for suffix, content in zip(SUFFIXES, files, strict=True):
        if content is not None:
            write_whole(folder / f"{name}.{suffix}", content)


def saved_tables(folder: Path, names: Sequence[str]) -> list[SavedTable]:
    """The named tables that are complete in the folder."""
    return [each for name in names if (each := load_saved(folder, name)) is not None]


def reusable_tables(folder: Path, names: Sequence[str], origin: Origin) -> list[SavedTable]:
    """Those of them that have this origin, with their CSV and LaTeX files."""
    return [
        each
        for each in saved_tables(folder, names)
        if each.origin == origin and all((folder / f"{each.table.name}.{end}").is_file() for end in SUFFIXES[:2])
    ]


def write_report(folder: Path, content: bytes, force: bool) -> None:
    """Write the page unless it is as it should be; raises AlreadyExists for another one, unless `force`."""
    page = folder / PAGE
    if not (page.is_file() and page.read_bytes() == content):
        refuse_existing(page, force)
        write_whole(page, content)
