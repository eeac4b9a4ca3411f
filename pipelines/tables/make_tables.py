"""Tables are measured, their walks on all cores, judged and written."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import pandas as pd

from quadlog.errors import UnknownName
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.executor.progress import Progress, Silent
from quadlog.pipelines.tables import TABLES
from quadlog.pipelines.tables.claims import StudyTable
from quadlog.results.page.blocks import write_page
from quadlog.results.studies.papers import PAGE, PaperTable, papers_page, prepare_folder, write_table


def measure_tables(
    tables: Mapping[str, StudyTable], fast: bool, seed: int, executor: Executor, progress: Progress
) -> Iterator[tuple[PaperTable, list[dict[str, Any]]]]:
    """Each table with its walks, once these are there; all are handed out at first, so that no core waits for a table.

    How many cores there are changes nothing in them. Raises WorkerDied when one is killed.
    """
    progress.begin("walks", sum(len(table.study.points) for table in tables.values()))
    # The walks of the last tables take longest, and would leave cores idle at the end.
    futures = {name: tables[name].study.submit(executor) for name in reversed([*tables])}
    for name, table in tables.items():
        figures = []
        for future in futures[name]:
            figures.append(future.result())
            progress.advance()
        walks = table.study.records(figures)
        yield table.on(pd.DataFrame(walks), name, fast, seed), walks


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

    Raises UnknownName, AlreadyExists and CannotWrite, all before anything is measured.
    """
    progress = progress or Silent()
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        raise UnknownName("table", unknown[0], TABLES)
    chosen = [name for name in TABLES if name in names or not names]
    prepare_folder(folder, chosen, force)
    progress.say(f"{', '.join(chosen)}: {'fast' if fast else 'full'} run, seed {seed}")
    tables, made = {name: importlib.import_module(TABLES[name]).table(fast, seed) for name in chosen}, []
    with LocalPool(min(cores(), sum(len(table.study.points) for table in tables.values()))) as executor:
        for table, walks in measure_tables(tables, fast, seed, executor, progress):
            write_table(folder, table, walks)
            made.append(table)
    write_page(folder / PAGE, papers_page(made))
    return made
