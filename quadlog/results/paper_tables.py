"""The folder of the papers' tables: one page, and a CSV, a LaTeX and a JSON file and pictures for each table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.results.files import write_whole
from quadlog.results.paper_page import csv_text, latex_text
from quadlog.results.paper_readme import Appendix, readme_text
from quadlog.results.paper_store import Origin, SavedTable, json_bytes, load_saved, picture_file

README = "README.md"


def reusable_tables(folder: Path, names: Sequence[str], origin: Origin) -> list[SavedTable]:
    """Those of the named tables that lie whole in a folder and have this origin."""
    saved = (load_saved(folder, name) for name in names)
    return [each for each in saved if each is not None and each.origin == origin]


def prepare_folder(folder: Path, names: Sequence[str], reused: Sequence[SavedTable], force: bool) -> None:
    """Make the folder, before anything is measured for the named tables.

    Raises CannotWrite, and unless `force` AlreadyExists for the page and for a file of theirs,
    and for a file of a reused table that is not as it would be written.
    """
    for path in () if force else _in_the_way(folder, names, reused):
        if path.exists():
            raise AlreadyExists(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error


def write_table(folder: Path, saved: SavedTable) -> None:
    """One table's files, each whole; its JSON file last, for that one says that the others are there."""
    for name, content in _files(saved).items():
        if not _holds(folder / name, content):
            write_whole(folder / name, content)


def write_readme(folder: Path, names: Sequence[str], code: str, appendices: Sequence[Appendix], force: bool) -> Path:
    """The page of all tables that the folder holds, also those of earlier commands, in the order of names.

    Raises AlreadyExists for another page, unless `force`.
    """
    saved = [each for name in names if (each := load_saved(folder, name)) is not None]
    page, text = folder / README, readme_text(saved, code, appendices).encode()
    if not _holds(page, text):
        if page.exists() and not force:
            raise AlreadyExists(page)
        write_whole(page, text)
    return page


def _in_the_way(folder: Path, names: Sequence[str], reused: Sequence[SavedTable]) -> Iterator[Path]:
    if names:
        yield folder / README
    for name in names:
        yield from (folder / f"{name}.{suffix}" for suffix in ("csv", "tex", "json"))
        yield from sorted(folder.glob(f"{name}-*.png"))
    for saved in reused:
        yield from (folder / name for name, content in _files(saved).items() if not _holds(folder / name, content))


def _files(saved: SavedTable) -> dict[str, bytes]:
    """What a table is written as, by file name, in the order of writing."""
    table = saved.table
    pictures = {picture_file(table, picture): picture.png for picture in table.pictures}
    texts = {f"{table.name}.csv": csv_text(table).encode(), f"{table.name}.tex": latex_text(table).encode()}
    return {**pictures, **texts, f"{table.name}.json": json_bytes(saved)}


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content
