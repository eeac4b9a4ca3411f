"""Stage `control` in a second process, while this one plans and loads what draws; its result comes by the store.

Nothing depends on it: what it has not left in the store is done here, and errors are raised here.
"""

from __future__ import annotations

import gc
import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from quadlog.config.controllers import CONTROLLERS
from quadlog.pipelines.executor.machine import cores, ignore_interrupts
from quadlog.pipelines.executor.progress import Progress, TaskProgress, send_to, start_up
from quadlog.pipelines.request import ReplayRequest
from quadlog.storage.atomic_write import remove_unfinished


@contextmanager
def second_process(
    stages: Collection[str], request: ReplayRequest, progress: Progress
) -> Iterator[SecondProcess | None]:
    """One that ends with the block, where `control` is among the stages and a robot with a body walks.

    None on one core, in a batch's workers, which share the cores already, by commands, which are read from the log,
    and for controllers of plug-ins: what they print and raise belongs to this process, once.
    """
    simulation = request.config.simulation
    shared = "control" in stages and simulation.has_body and simulation.controller in CONTROLLERS
    if not shared or parent_process() is not None or cores() < 2:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="quadlog-", ignore_cleanup_errors=True) as scratch:
        second = SecondProcess(request, Path(scratch), progress)
        try:
            yield second
        finally:
            second.end()


class SecondProcess:
    """The process; it loads what it needs at once, and compiles it at the first start."""

    def __init__(self, request: ReplayRequest, scratch: Path, progress: Progress) -> None:
        """scratch: an empty folder for what it needs of the run, which it removes if this process is killed."""
        self._request, self._progress = request, progress
        self._said: SimpleQueue[bytes] = SimpleQueue()
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-P", "-m", __name__, request.config.simulation.controller, str(scratch)],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},  # the same code as here
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for this process, which ends that one
        )
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.put(line)
        self._said.put(b"")

    def made(self, stage: str) -> bool:
        """Whether it has just made the result of this stage, which is wanted next; it begins when `plan` is."""
        if stage == "plan":
            with suppress(OSError):
                assert self._process.stdin is not None
                pickle.dump(self._request, self._process.stdin)
                self._process.stdin.flush()
        if stage != "control":
            return False
        with start_up.loading():
            import quadlog.pipelines.stages.report

            if self._request.plots:
                import quadlog.results.mpl  # noqa: F401
        steps = None
        while line := self._said.get():
            told = json.loads(line)
            if steps is None:
                self._progress.begin("control", told["total"])
            for _ in range(steps or 0, told["steps"]):
                self._progress.advance()
            steps = told["steps"]
        return self._process.wait() == 0

    def end(self) -> None:
        """Kill it, unless it has ended."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()


def main(controller: str, scratch: str) -> None:
    """In the second process: load, compile by a tenth of a second's walk, wait for the order, and do it."""
    ignore_interrupts()
    orders = sys.stdin.buffer
    taken: SimpleQueue[ReplayRequest] = SimpleQueue()
    threading.Thread(target=_leave_with_parent, args=(orders, taken, scratch), daemon=True).start()
    import quadlog.pipelines.stages.maps
    import quadlog.pipelines.stages.plan
    import quadlog.pipelines.stages.positions.position  # noqa: F401
    from quadlog.pipelines.executor.compilation import load_compiler
    from quadlog.pipelines.replay import control_alone
    from quadlog.pipelines.stages.control import warm_up

    load_compiler()
    warm_up(controller)
    gc.freeze()
    request = taken.get()
    send_to(_tell)
    control_alone(request, Path(scratch), TaskProgress(0, request.run.name))
    os._exit(0)  # the other thread reads on, and taking the interpreter down costs half a second


def _leave_with_parent(orders: Any, taken: SimpleQueue[ReplayRequest], scratch: str) -> None:
    """Take the order; and do not outlive a parent that is killed, which closes the pipe."""
    with suppress(EOFError, OSError):
        taken.put(pickle.load(orders))  # noqa: S301  from the process that started this one
        orders.read()
    remove_unfinished()
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(1)


def _tell(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps({name: message[name] for name in ("total", "steps")}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    finally:
        os._exit(1)  # the interpreter's own end aborts where a thread reads
