"""Tables measured on all cores: those that share their walks out themselves one by one, the others side by side."""

from __future__ import annotations

import importlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from quadlog.errors import QuadlogError
from quadlog.pipelines.stages.first_compilation import cores
from quadlog.results.paper_rows import PaperTable

SHARED_OUT = ("tracking-courses", "tracking-5", "foot-drift")
"""Their walks go out over the cores: side by side with others they would only be in the way."""
LONGEST_FIRST = ("planning-1", "planning-2", "following-2", "following-lidar")
"""Of the others, so that no core waits long for the last one."""


def measure_tables(
    modules: dict[str, str], fast: bool, seed: int, say: Callable[[str], None]
) -> Iterator[tuple[str, PaperTable]]:
    """Each table with its name, as soon as it is measured. modules: by name, each with make_table(fast, seed).

    Which cores there are changes the order they come in, and nothing in them. Raises QuadlogError when a worker is
    killed.
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
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_leave_interrupts_alone) as pool:
        try:
            futures = {pool.submit(_measure, module, fast, seed): name for name, module in modules.items()}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise QuadlogError("a worker process was killed (out of memory?)") from None
        except BaseException:
            # Ctrl-C, or a table that failed: what has not begun is not measured, and nobody waits for what has.
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def _leave_interrupts_alone() -> None:
    """Ctrl-C reaches every process; the one that has the terminal ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _measure(module: str, fast: bool, seed: int) -> PaperTable:
    table: PaperTable = importlib.import_module(module).make_table(fast, seed)
    return table
