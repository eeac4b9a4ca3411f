"""Compilation at the first start, when numba's cache is empty: announced, timed, and shared with a second process.

Compiling holds a lock within one process, so a second core helps only another process, whose results are then found in
the cache.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import parent_process
from typing import Any

import numpy as np
from numba.core import event

from quadlog.config.controllers import CONTROLLERS
from quadlog.config.schema import Config
from quadlog.pipelines.executor.machine import cores

SAID = "compiling for the first time on this machine, 3 to 20 s depending on the log; later starts use the cache"
LONGEST_S = 600.0
"""The second process is killed after this."""


class _Clock(event.Listener):
    """Seconds that this process has compiled, and what to call when it does so next. Compilations nest."""

    seconds, began_s, depth = 0.0, 0.0, 0
    on_next: Callable[[], None] | None = None

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
            self.seconds += time.perf_counter() - self.began_s


_clock = _Clock()
event.register("numba:compile", _clock)  # type: ignore[no-untyped-call]


def compiling_s() -> float:
    """Seconds that this process has compiled so far, or waited for the second process."""
    return _clock.seconds


@contextmanager
def on_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once, when the body compiles anything for the first time."""
    _clock.on_next = call
    try:
        yield
    finally:
        _clock.on_next = None


@contextmanager
def compilation(stages: Collection[str], config: Config, say: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """Say so when the body first compiles, and compile `position` and `control`, half of all, in a second process.

    That one begins with those of these stages that have not begun by then, and ends with the body; a batch's workers
    start none, since they share the cores already. To be called before a stage begins: the yielded function, which
    waits for the second process if it has the stage.
    """
    shared = [name for name in ("position", "control") if name in stages]
    if not config.simulation.has_body:
        shared = shared[: shared.count("position")]
    open_ones: list[str] = []  # of the second process
    lines: Iterator[str] = iter(())

    def start() -> None:
        nonlocal lines
        say(SAID)
        if shared and cores() > 1 and parent_process() is None:
            open_ones.extend(shared)
            lines = stack.enter_context(_second_process(config.simulation.controller, *shared))

    def before(name: str) -> None:
        shared[:] = [other for other in shared if other != name]
        began_s = time.perf_counter()
        while name in open_ones:
            done = next(lines, "").strip()
            open_ones[:] = [other for other in open_ones if done not in (other, "")]
        _clock.seconds += time.perf_counter() - began_s

    with ExitStack() as stack, on_first_compilation(start):
        yield before


@contextmanager
def _second_process(*arguments: str) -> Iterator[Iterator[str]]:
    """The lines that `main` prints in a process of its own, which ends with the block."""
    process = subprocess.Popen(  # noqa: S603 (constants)
        [sys.executable, "-P", "-m", __name__, *arguments],  # -P: imports nothing from the working folder
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    late = threading.Timer(LONGEST_S, process.kill)
    late.start()
    try:
        assert process.stdout is not None
        with process.stdout as lines:
            yield lines
    finally:
        late.cancel()
        process.kill()
        process.wait()


def main(controller: str, *names: str) -> None:
    """Compile stages in this process by running them once, and print the name of each when it is done."""
    gc.disable()  # not worth the time in a process that ends soon
    for name in names:
        if name == "position":
            _locate_toy_tag()
        else:
            _walk_toy_robot(controller)
        sys.stdout.write(f"{name}\n")
        sys.stdout.flush()


def _locate_toy_tag() -> None:
    """A second of a tag that walks between three anchors, with every step that a real one takes."""
    from quadlog.messages import RangeSeries
    from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate

    anchor_m = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]])
    t_ns = np.arange(50, dtype=np.int64) * 20_000_000
    walk_m = np.column_stack([2 + t_ns * 1e-9, np.full(50, 3.0), np.ones(50)])
    range_m = np.linalg.norm(walk_m[:, None] - anchor_m, axis=2)
    ids = np.arange(3, dtype=np.int64)
    ranges = RangeSeries(np.repeat(t_ns, 3), np.zeros(150, dtype=np.int64), np.tile(ids, 50), range_m.ravel())
    for smooth in (True, False):
        locate(ranges, Anchors(ids, anchor_m, np.zeros(3)), [TagInfo(0, 1.0)], LocateSettings(smooth=smooth))


def _walk_toy_robot(controller: str) -> None:
    """A tenth of a second of a robot with a body."""
    from quadlog.control.locomotion.robot import ROBOTS
    from quadlog.control.locomotion.walker import WalkerSettings
    from quadlog.simulation.robot.height_field import flat
    from quadlog.simulation.robot.model import quadruped_model
    from quadlog.simulation.robot.walking_robot import WalkingRobot

    settings = WalkerSettings(whole_body=CONTROLLERS[controller].whole_body)
    robot = WalkingRobot(quadruped_model(ROBOTS["tracking"], flat()), settings, np.zeros(3), np.random.default_rng(0))
    robot.walk(50, 0.3, 0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
