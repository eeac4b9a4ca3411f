"""The story of `quadlog tables`: what is measured already is taken, the rest measured and written at once; the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadlog.errors import UnknownName
from quadlog.pipelines.progress import Progress, Silent
from quadlog.pipelines.tables.code_digest import code_digest
from quadlog.pipelines.tables.errata import errata_appendix
from quadlog.pipelines.tables.measuring import measure_tables
from quadlog.pipelines.tables.registry import TABLES
from quadlog.pipelines.tables.where_figures_are import figures_appendix
from quadlog.results.paper_rows import PaperTable
from quadlog.results.paper_store import Origin, SavedTable
from quadlog.results.paper_tables import prepare_folder, reusable_tables, write_readme, write_table


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

    A table that lies in the folder, whole and measured by this very code with the same seed and size, is taken as it
    is. Raises UnknownName, AlreadyExists and CannotWrite, all before anything is measured.
    """
    progress = progress or Silent()
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        raise UnknownName("table", unknown[0], TABLES)
    chosen = [name for name in TABLES if name in names or not names]
    origin = Origin(code_digest(), fast, seed)
    reused = reusable_tables(folder, chosen, origin)
    tables = {saved.table.name: saved.table for saved in reused}
    missing = {name: TABLES[name] for name in chosen if name not in tables}
    prepare_folder(folder, list(missing), reused, force)
    if reused:
        progress.say(f"measured before, and nothing has changed since: {', '.join(tables)}")
    for saved in reused:
        write_table(folder, saved)
    progress.begin("tables", len(missing))
    for name, table in measure_tables(missing, fast, seed, progress.say):
        write_table(folder, SavedTable(table, origin))
        tables[name] = table
        progress.advance()
    write_readme(folder, list(TABLES), origin.code, (figures_appendix(), errata_appendix()), force)
    return [tables[name] for name in chosen]
