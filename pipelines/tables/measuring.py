"""Tables measured on all cores: those that share their walks out themselves one by one, the others side by side."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed

from quadlog.pipelines.engine.cores import cores
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.results.paper_rows import PaperTable

SHARED_OUT = ("tracking-courses", "tracking-5", "foot-drift")
"""Their walks go out over the cores: side by side with others they would only be in the way."""
LONGEST_FIRST = ("planning-1", "planning-2", "following-2", "following-lidar")
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
