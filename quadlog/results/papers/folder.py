"""The folder of the papers' tables: a CSV and LaTeX file for each table, pictures and JSON, and the page of all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from quadlog.errors import CannotWrite
from quadlog.results.find_runs import refuse_existing
from quadlog.results.numbers import sig
from quadlog.results.papers.table import Origin, PaperRow, PaperTable, SavedTable, json_bytes, load_saved, picture_file
from quadlog.results.text import TitledTable, print_table, print_tables
from quadlog.storage.atomic_write import write_whole

PAGE = "report.html"
COLUMNS = ("quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note")
SHOWN = ("quantity", "paper", "ours", "95 % interval", "difference", "reproduces")


def csv_text(table: PaperTable) -> str:
    """All rows in full precision, an empty field where there is no value."""
    rows = [
        (row.quantity, row.paper, row.ours, row.low, row.high, row.difference, format_verdict(row), row.note)
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
    return row.quantity, paper, _short(row.ours), interval, difference, format_verdict(row)


def _short(value: float | None) -> str:
    return "" if value is None else sig(value, 4)


def format_verdict(row: PaperRow) -> str:
    """A Verdict's word, or empty."""
    return "" if row.reproduces is None else str(row.reproduces)


def reusable_tables(folder: Path, names: Sequence[str], origin: Origin) -> list[SavedTable]:
    """Those of the named tables that are complete in a folder and have this origin."""
    saved = (load_saved(folder, name) for name in names)
    return [each for each in saved if each is not None and each.origin == origin]


def prepare_folder(folder: Path, names: Sequence[str], reused: Sequence[SavedTable], force: bool) -> None:
    """Make the folder, before the named tables are measured.

    Raises CannotWrite, and unless `force` AlreadyExists for the page and for a file of theirs,
    and for a file of a reused table that is not as it would be written.
    """
    for path in _in_the_way(folder, names, reused):
        refuse_existing(path, force)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error


def write_table(folder: Path, saved: SavedTable) -> None:
    """Write the files of a table; its JSON file last, since it marks the others as complete."""
    for name, content in _files(saved).items():
        if not _holds(folder / name, content):
            write_whole(folder / name, content)


def saved_tables(folder: Path, names: Sequence[str]) -> list[SavedTable]:
    """The named tables that are complete in the folder."""
    return [each for name in names if (each := load_saved(folder, name)) is not None]


def write_report(folder: Path, content: bytes, force: bool) -> None:
    """Write the page unless it is as it should be; raises AlreadyExists for another one, unless `force`."""
    page = folder / PAGE
    if not _holds(page, content):
        refuse_existing(page, force)
        write_whole(page, content)


def _in_the_way(folder: Path, names: Sequence[str], reused: Sequence[SavedTable]) -> Iterator[Path]:
    if names:
        yield folder / PAGE
    for name in names:
        yield from (folder / f"{name}.{suffix}" for suffix in ("csv", "tex", "json"))
        yield from sorted(folder.glob(f"{name}-*.png"))
    for saved in reused:
        yield from (folder / name for name, content in _files(saved).items() if not _holds(folder / name, content))


def _files(saved: SavedTable) -> dict[str, bytes]:
    """Contents of a table's files by name, in the order of writing."""
    table = saved.table
    pictures = {picture_file(table, picture): picture.png for picture in table.pictures}
    texts = {f"{table.name}.csv": csv_text(table).encode(), f"{table.name}.tex": latex_text(table).encode()}
    return {**pictures, **texts, f"{table.name}.json": json_bytes(saved)}


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content
