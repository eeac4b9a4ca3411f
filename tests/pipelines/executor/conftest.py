"""Tasks for other processes, in a module that those can import, and pipes by which a test holds and frees them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TASKS = '''
import ctypes, os, sys, tempfile
from pathlib import Path
from quadlog.errors import UnknownName
from quadlog.pipelines.executor import local_pool
from quadlog.pipelines.executor.progress import tell
from quadlog.storage.atomic_write import whole_file

def variable(name):
    return os.environ.get(name)

def held(gate, answer):
    """Says that it has begun, and waits until the test opens the gate."""
    tell({"begun": answer, "pid": os.getpid()})
    Path(gate).read_bytes()
    return answer, os.getpid()

def held_with_files(gate, folder):
    with tempfile.TemporaryDirectory(dir=folder), whole_file(Path(folder, "whole")) as part:
        part.write_bytes(b"half")
        held(gate, "files")

def held_and_writing(gate, pipe, folder):
    """The pipe ends when this process does."""
    with open(pipe, "w"):
        held_with_files(gate, folder)

def held_below_c(gate, folder):
    """What is raised amid the wait, the C code that called for it cannot pass on."""
    with tempfile.TemporaryDirectory(dir=folder):
        ctypes.CFUNCTYPE(None)(lambda: held(gate, "below C"))()
        Path(gate).read_bytes()

def held_and_mistaken(gate):
    try:
        held(gate, "mistaken")
    except SystemExit as error:
        print("a bug", file=sys.stderr, flush=True)
        raise ImportError("initialization failed") from error

def unwind_at_once():
    local_pool.UNWIND_S = 0.0

def held_by_force(gate):
    while True:
        try:
            held(gate, "by force")
        except SystemExit:
            pass

class Stubborn(Exception):
    def __reduce__(self):
        raise TypeError("no pickle")

class Fragile(Exception):
    def __init__(self, one, two):
        super().__init__("of two")

def fail(kind):
    if kind == "named":
        raise UnknownName("planner", "z_star", ["astar"])
    raise {"stubborn": Stubborn("own words"), "fragile": Fragile(1, 2)}[kind]

def unpicklable():
    return lambda: None

def die_once(folder):
    """The first one to make the file is killed."""
    try:
        Path(folder, "died").touch(exist_ok=False)
    except FileExistsError:
        return os.getpid()
    os.kill(os.getpid(), 9)

def die_if(kill):
    if kill:
        os.kill(os.getpid(), 9)
    return "alive"

def die_with(number, progress):
    os.kill(os.getpid(), number)

def square_aloud(number, progress):
    if number < 0:
        raise UnknownName("number", str(number), ["1"])
    progress.say(f"{number} squared")
    return number**2

def talk_on(pipe):
    """Until it is stopped; the pipe ends then."""
    with open(pipe, "w"):
        while True:
            tell("on")

def is_replaying():
    from quadlog.pipelines.executor import dask_cluster
    return dask_cluster._one_at_a_time.locked()

def count_executing(dask_worker):
    return dask_worker.state.executing_count

def talk(words):
    for word in words:
        tell(word)
    return len(words)
'''


# A port of its own, beside whatever else runs on this machine, and no pages behind it.
QUIET = {"dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False}}


@pytest.fixture(scope="session")
def task_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the module of tasks is, for those who set a path of their own."""
    return tmp_path_factory.mktemp("tasks")


@pytest.fixture(scope="session")
def tasks(task_folder: Path) -> Iterator[ModuleType]:
    """The module of tasks."""
    (task_folder / "quadlog_test_tasks.py").write_text(TASKS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(task_folder))
        yield import_module("quadlog_test_tasks")


@pytest.fixture(scope="session")
def cluster(tasks: ModuleType) -> Iterator[Any]:
    """Two workers of two threads, each in a process with a nanny that starts it again when it dies."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=2, host="127.0.0.1", **QUIET) as cluster:
        yield cluster


@pytest.fixture
def empty_cluster() -> Callable[[], Any]:
    """Makes a cluster that has no workers yet."""
    from distributed import LocalCluster

    def make() -> Any:
        return LocalCluster(n_workers=0, threads_per_worker=1, host="127.0.0.1", **QUIET)

    return make


@pytest.fixture
def gate(tmp_path: Path) -> Callable[[str], Path]:
    """Makes a named pipe: whoever reads it waits until it has been opened to write."""

    def make(name: str) -> Path:
        path = tmp_path / name
        os.mkfifo(path)
        return path

    return make
