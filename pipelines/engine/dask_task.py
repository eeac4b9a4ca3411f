"""What a worker of a Dask cluster does with a task of quadlog's."""

from __future__ import annotations

import os
import platform
import threading
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any

from quadlog.errors import VersionsDiffer
from quadlog.pipelines.engine.telling import told_to

PYTHON = "Python"
DECISIVE = ("quadlog", "numpy", "scipy", "numba", "llvmlite", "mujoco", "daqp", "quadprog", "pyarrow")
"""Packages that results depend on to the last bit: arithmetic, compilers, solvers, and what writes tables."""

# What a replay reads into module-level work arrays, and the memory it may take, are meant for one at a time, however
# many threads a worker has. A lock, since Dask's own resources would have to be given to each worker when it starts.
_one_at_a_time = threading.Lock()
_stopped: set[str] = set()


class Stopped(Exception):
    """Nobody waits for this task any more."""


def do_task(topic: str, versions: Mapping[str, str], call: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
    """The call's result; what it tells goes to the topic of the scheduler's events.

    Raises VersionsDiffer on a worker that joined later with others, Stopped after `stop_tasks`, and what call raises.
    """
    from distributed import get_worker

    worker = get_worker()
    check_versions(str(worker.address), versions, own_versions())
    os.environ.setdefault("MUJOCO_GL", "disable")  # as the command line has it: nothing here draws with it

    def pass_on(message: Any) -> None:
        if topic in _stopped:
            raise Stopped
        worker.log_event(topic, message)

    with _one_at_a_time, told_to(pass_on, str(worker.address)):
        if topic in _stopped:
            raise Stopped
        return call(*args, **kwargs)


def stop_tasks(topic: str) -> None:
    """Tasks of this topic, which is one command's alone, end with the next thing they tell."""
    _stopped.add(topic)


def own_versions() -> dict[str, str]:
    """Of Python, as far as its minor number, and of DECISIVE; "none" where one is not installed."""
    found = {PYTHON: minor(platform.python_version())}
    for name in DECISIVE:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "none"
    return found


def minor(version: str) -> str:
    """3.12 of 3.12.4, which pickles and results are the same with."""
    return ".".join(version.split(".")[:2])


def check_versions(worker: str, wanted: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Raises VersionsDiffer when anything differs between the one who asks and the worker."""
    differing = [(name, found.get(name, "none"), wanted[name]) for name in wanted if found.get(name) != wanted[name]]
    if differing:
        raise VersionsDiffer(worker, differing)
