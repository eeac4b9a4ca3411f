"""The story of `quadlog tables`: each table of a paper measured again and written at once, then the page of all."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

from quadlog.errors import UnknownName
from quadlog.pipelines.progress import Progress, Silent
from quadlog.pipelines.tables.registry import TABLES
from quadlog.results.paper_rows import PaperTable
from quadlog.results.paper_tables import prepare_folder, write_readme, write_table


def make_tables(
    names: Sequence[str],
    folder: Path,
    *,
    fast: bool = False,
    seed: int = 0,
    force: bool = False,
    progress: Progress | None = None,
) -> list[PaperTable]:
    """Make and write the named tables, all there are when none is named, in the order of TABLES.

    Raises UnknownName, AlreadyExists and CannotWrite, all before anything is computed.
    """
    progress = progress or Silent()
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        raise UnknownName("table", unknown[0], TABLES)
    chosen = [name for name in TABLES if name in names or not names]
    prepare_folder(folder, chosen, force)
    progress.begin("tables", len(chosen))
    tables = []
    for name in chosen:
        progress.say(f"{name}: {'fast' if fast else 'full'} run, seed {seed}")
        table: PaperTable = importlib.import_module(TABLES[name]).make_table(fast, seed)
        write_table(folder, table)
        tables.append(table)
        progress.advance()
    write_readme(folder, list(TABLES))
    return tables
