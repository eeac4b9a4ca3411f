"""Tables are measured, several at a time, and written; what was measured by the same code on the same kind of machine
is reused.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import platform
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from pathlib import Path

import quadlog
from quadlog import pipelines
from quadlog.config.version import package_versions
from quadlog.errors import UnknownName
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.executor.progress import Progress, Silent
from quadlog.pipelines.tables.errata import errata_section
from quadlog.pipelines.tables.figure_index import figures_section
from quadlog.pipelines.tables.real.recordings import folder_of_datasets
from quadlog.pipelines.tables.registry import TABLES
from quadlog.results.page.blocks import render
from quadlog.results.page.papers import papers_page
from quadlog.results.papers.folder import prepare_folder, reusable_tables, saved_tables, write_report, write_table
from quadlog.results.papers.table import Origin, PaperTable, SavedTable

ONLY_PRINTS = "quadlog/cli/"


def code_digest() -> str:
    """SHA-256 over every source file but the command line's, and over the versions of what they call.

    It changes more often than the numbers do: no change of a number is ever missed.
    """
    sources = {
        f"{top}/{path.relative_to(root).as_posix()}": hashlib.sha256(path.read_bytes()).hexdigest()
        for top, root in _roots()
        for path in root.rglob("*.py")
    }
    judged = {name: digest for name, digest in sources.items() if not name.startswith(ONLY_PRINTS)}
    # Compiled code may round otherwise on another kind of machine.
    machine = [platform.python_version(), platform.system(), platform.machine()]
    everything = {"sources": judged, "packages": package_versions(), "machine": machine}
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


def _roots() -> list[tuple[str, Path]]:
    """The pipelines lie beside quadlog in a checkout, and inside it once installed; they have one name in both."""
    return [(package.__name__.replace(".", "/"), Path(package.__path__[0])) for package in (quadlog, pipelines)]


SHARED_OUT = ("tracking-courses", "tracking-5", "foot-drift")
"""Their walks go out over the cores: side by side with others they would only be in the way."""
LONGEST_FIRST = ("planning-1", "planning-2", "following-2", "uwb-real", "following-lidar")
"""Of the others, so that no core waits long for the last one."""


def measure_tables(
    modules: dict[str, str], fast: bool, seed: int, say: Callable[[str], None]
) -> Iterator[tuple[str, PaperTable]]:
    """Each table with its name, as soon as it is measured. modules: by name, each with make_table(fast, seed).

    Which cores there are changes the order they come in, and nothing in them. Raises WorkerDied when one is killed.
    """
    alone = sorted((name for name in modules if name not in SHARED_OUT), key=_turn)
    one_by_one = [name for name in modules if name in SHARED_OUT]
    workers = min(cores(), len(alone))
    if workers > 1:
        yield from _side_by_side({name: modules[name] for name in alone}, fast, seed, workers, say)
    else:
        one_by_one = alone + one_by_one
    for name in one_by_one:
        say(_announced([name], fast, seed))
        yield name, _measure(modules[name], fast, seed)


def _turn(name: str) -> int:
    return LONGEST_FIRST.index(name) if name in LONGEST_FIRST else len(LONGEST_FIRST)


def _announced(names: Sequence[str], fast: bool, seed: int) -> str:
    return f"{', '.join(names)}: {'fast' if fast else 'full'} run, seed {seed}"


def _side_by_side(
    modules: dict[str, str], fast: bool, seed: int, workers: int, say: Callable[[str], None]
) -> Iterator[tuple[str, PaperTable]]:
    say(_announced(list(modules), fast, seed))
    with LocalPool(workers) as pool:
        futures = {pool.submit(_measure, module, fast, seed): name for name, module in modules.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _measure(module: str, fast: bool, seed: int) -> PaperTable:
    table: PaperTable = importlib.import_module(module).make_table(fast, seed)
    return table


def _can_be_made_now(table: PaperTable) -> bool:
    """Whether it was skipped for want of recordings that are there by now."""
    return not table.rows and folder_of_datasets() is not None


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
    reused = [saved for saved in reusable_tables(folder, chosen, origin) if not _can_be_made_now(saved.table)]
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
    page = papers_page(saved_tables(folder, list(TABLES)), origin.code, (figures_section(), errata_section()))
    write_report(folder, render(page), force)
    return [tables[name] for name in chosen]
