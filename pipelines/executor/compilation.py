"""Compilation at the first start, when numba's cache is empty: announced, timed, and shared with a second process.

Compiling holds a lock within one process, so a second core helps only another process, whose results are then found in
the cache.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing import parent_process
from typing import Any

import numpy as np
from numba.core import event
from numba.core.registry import cpu_target

from quadlog.config.controllers import CONTROLLERS
from quadlog.config.schema import Config
from quadlog.open3d import import_open3d
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.progress import Progress, start_up

SAID = "compiling for the first time on this machine, 3 to 20 s depending on the log; later starts use the cache"
LONGEST_S = 600.0
"""The second process is not waited for any longer."""
NOTHING = subprocess.DEVNULL


class _Clock(event.Listener):
    """Adds what this process compiles to its start-up, and what to call at the next time and each time. They nest."""

    began_s, depth, kernels = 0.0, 0, 0
    on_next: Callable[[], None] | None = None
    on_each: Callable[[int], None] | None = None

    def on_start(self, event: Any) -> None:
        self.depth += 1
        if self.depth == 1:
            self.began_s = time.perf_counter()
            call, self.on_next = self.on_next, None
            if call is not None:
                call()

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0:
            start_up.seconds += time.perf_counter() - self.began_s
            self.kernels += 1
            if self.on_each is not None:
                self.on_each(self.kernels)


_clock = _Clock()
event.register("numba:compile", _clock)  # type: ignore[no-untyped-call]


@cache
def load_compiler() -> None:
    """What numba would load at the first call of any compiled function, cached or not: a third of a second."""
    cpu_target.typing_context.refresh()  # type: ignore[no-untyped-call]
    cpu_target.target_context.refresh()  # type: ignore[no-untyped-call]


@contextmanager
def on_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once, when the body compiles anything for the first time."""
    _clock.on_next = call
    try:
        yield
    finally:
        _clock.on_next = None


@contextmanager
def compilation(stages: Collection[str], config: Config, progress: Progress) -> Iterator[Callable[[str], None]]:
    """Say so when the body first compiles, and compile `control`, half of all, in a second process meanwhile.

    That process ends with the body. There is none on one core, in a batch's workers, which share the cores already, and
    where `control` is not among the stages. Yields a function to be called before each stage: it loads what the stage's
    compiled code needs, keeps what lives by then out of the search for garbage, and waits for the process.
    """
    is_shared = "control" in stages and config.simulation.has_body and parent_process() is None and cores() > 1
    second: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        progress.say(SAID)
        _clock.kernels, _clock.on_each = 0, progress.compiled
        if is_shared:
            command = [sys.executable, "-P", "-m", __name__, config.simulation.controller]  # -P: not the working folder
            second.append(subprocess.Popen(command, stdin=NOTHING, stdout=NOTHING, stderr=NOTHING))  # noqa: S603

    def before(name: str) -> None:
        nonlocal is_shared
        gc.freeze()  # what is loaded by now lives on; searching it for garbage takes a tenth of a second each time
        with start_up.loading():
            if name not in ("ingest", "position"):
                load_compiler()
            if name == "filter" and config.lidar.method == "paper":
                import_open3d()
            if name == "control":
                is_shared = False
                with suppress(subprocess.TimeoutExpired):
                    for process in second:
                        process.wait(LONGEST_S)

    with on_first_compilation(start):
        try:
            yield before
        finally:
            _clock.on_each = None
            gc.unfreeze()
            for process in second:
                process.kill()
                process.wait()


def main(controller: str) -> None:
    """Compile what a robot with a body needs, by a tenth of a second of one."""
    from quadlog.control.locomotion.robot import ROBOTS
    from quadlog.control.locomotion.walker import WalkerSettings
    from quadlog.simulation.robot.height_field import flat
    from quadlog.simulation.robot.model import quadruped_model
    from quadlog.simulation.robot.walking_robot import WalkingRobot

    gc.disable()  # not worth the time in a process that ends soon
    settings = WalkerSettings(whole_body=CONTROLLERS[controller].whole_body)
    robot = WalkingRobot(quadruped_model(ROBOTS["tracking"], flat()), settings, np.zeros(3), np.random.default_rng(0))
    robot.walk(50, 0.3, 0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
