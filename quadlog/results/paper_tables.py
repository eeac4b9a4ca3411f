"""The folder of the papers' tables: one page, and a CSV file, a LaTeX file and pictures for each table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.results.files import write_whole
from quadlog.results.paper_page import csv_text, latex_text, picture_file, readme_text, section_text
from quadlog.results.paper_rows import PaperTable

README = "README.md"


def prepare_folder(folder: Path, names: Sequence[str], force: bool) -> None:
    """Make the folder, before any work is done for it. Raises AlreadyExists unless `force`, and CannotWrite."""
    outputs = [folder / README, *(folder / f"{name}.{suffix}" for name in names for suffix in ("md", "csv", "tex"))]
    pictures = [path for name in names for path in sorted(folder.glob(f"{name}-*.png"))]
    for path in (*outputs, *pictures):
        if path.exists() and not force:
            raise AlreadyExists(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error


def write_table(folder: Path, table: PaperTable) -> None:
    """One table's files, each whole; its section of the page last, for that one says that the others are there."""
    for picture in table.pictures:
        write_whole(folder / picture_file(table, picture), picture.png)
    write_whole(folder / f"{table.name}.csv", csv_text(table).encode())
    write_whole(folder / f"{table.name}.tex", latex_text(table).encode())
    write_whole(folder / f"{table.name}.md", section_text(table).encode())


def write_readme(folder: Path, names: Sequence[str]) -> Path:
    """The page of all tables that the folder holds, also those of earlier commands, in the order of names."""
    sections = [folder / f"{name}.md" for name in names]
    text = readme_text([section.read_text(encoding="utf-8") for section in sections if section.is_file()])
    write_whole(folder / README, text.encode())
    return folder / README
