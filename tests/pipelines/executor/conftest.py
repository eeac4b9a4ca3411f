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
import os, tempfile
from pathlib import Path
from quadlog.errors import UnknownName
from quadlog.pipelines.executor.progress import tell
from quadlog.storage.atomic_write import whole_file

def held(gate, folder=None):
    """With a file begun in the folder and a temporary one, until the test opens the gate."""
    with tempfile.TemporaryDirectory() as temporary:
        if folder is None:
            tell([os.getpid(), temporary, Path(gate).name])
            Path(gate).read_bytes()
            return os.getpid()
        with whole_file(Path(folder, "whole")):
            return held(gate)

def held_with_pipe(gate, pipe, folder):
    """The pipe ends when this process does."""
    with open(pipe, "w"):
        held(gate, folder)

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

def talk(words):
    for word in words:
        tell(word)
    return len(words)
'''


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
def make_cluster() -> Callable[[int], Any]:
    """Makes a cluster of so many workers, each with a nanny that starts it again when it dies."""
    from distributed import LocalCluster

    def make(workers: int) -> Any:
        # A port of its own, beside whatever else runs on this machine, and no pages behind it.
        quiet = {"dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False}}
        return LocalCluster(n_workers=workers, threads_per_worker=2, host="127.0.0.1", **quiet)

    return make


@pytest.fixture(scope="session")
def scheduler(tasks: ModuleType, make_cluster: Callable[[int], Any]) -> Iterator[str]:
    """The address of a cluster of two workers."""
    with make_cluster(2) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def gate(tmp_path: Path) -> Callable[[str], Path]:
    """Makes a named pipe: whoever reads it waits until it has been opened to write."""

    def make(name: str) -> Path:
        path = tmp_path / name
        os.mkfifo(path)
        return path

    return make
