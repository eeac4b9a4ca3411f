"""Tables are measured, their walks on all cores, judged and written; what was measured by the same code on the same
kind of machine is reused.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import pandas as pd

import quadlog
from quadlog import pipelines
from quadlog.config.version import package_versions
from quadlog.errors import UnknownName
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.executor.progress import Progress, Silent
from quadlog.pipelines.tables.claims import Table
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
    # The pipelines lie beside quadlog in a checkout, and inside it once installed; they have one name in both.
    roots = [(package.__name__.replace(".", "/"), Path(package.__path__[0])) for package in (quadlog, pipelines)]
    sources = {
        f"{top}/{path.relative_to(root).as_posix()}": hashlib.sha256(path.read_bytes()).hexdigest()
        for top, root in roots
        for path in root.rglob("*.py")
    }
    judged = {name: digest for name, digest in sources.items() if not name.startswith(ONLY_PRINTS)}
    # Compiled code may round otherwise on another kind of machine.
    machine = [platform.python_version(), platform.system(), platform.machine()]
    everything = {"sources": judged, "packages": package_versions(), "machine": machine}
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


def open_executor(tasks: int) -> Executor:
    """Where walks run."""
    return LocalPool(min(cores(), max(tasks, 1)))


def measure_tables(
    tables: Mapping[str, Table], origin: Origin, executor: Executor, progress: Progress
) -> Iterator[SavedTable]:
    """Each table as soon as its walks are there; all walks are handed out at first, so that no core waits for a table.

    How many cores there are changes nothing in them. Raises WorkerDied when one is killed.
    """
    progress.begin("walks", sum(len(table.study.points) for table in tables.values()))
    futures = {name: table.study.submit(executor) for name, table in tables.items()}
    for name, table in tables.items():
        figures = []
        for future in futures[name]:
            figures.append(future.result())
            progress.advance()
        walks = table.study.records(figures)
        yield SavedTable(table.on(pd.DataFrame(walks), name, origin.fast, origin.seed), origin, walks)


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
    made = {saved.table.name: saved.table for saved in reusable_tables(folder, chosen, origin)}
    missing = [name for name in chosen if name not in made]
    prepare_folder(folder, missing, force)
    if made:
        progress.say(f"measured before, and nothing has changed since: {', '.join(made)}")
    if missing:
        progress.say(f"{', '.join(missing)}: {'fast' if fast else 'full'} run, seed {seed}")
        tables = {name: importlib.import_module(TABLES[name]).table(fast, seed) for name in missing}
        with open_executor(sum(len(table.study.points) for table in tables.values())) as executor:
            for saved in measure_tables(tables, origin, executor, progress):
                write_table(folder, saved)
                made[saved.table.name] = saved.table
    page = papers_page(saved_tables(folder, list(TABLES)), origin.code)
    write_report(folder, render(page), force)
    return [made[name] for name in chosen]
