"""The machine: cores of a container, lack of memory in whatever form, and what is compiled at the first start."""

from __future__ import annotations

import errno
import time
from types import SimpleNamespace

import pyarrow as pa
import pytest
from numba import njit

from quadlog.config.schema import Config
from quadlog.errors import NotARun
from quadlog.pipelines.executor import machine as interrupts
from quadlog.pipelines.executor.compilation import SAID, compilation
from quadlog.pipelines.executor.machine import is_out_of_memory
from quadlog.pipelines.executor.progress import StageClock, start_up


@pytest.mark.parametrize(
    ("files", "most"),
    [
        ({"cpu.max": "150000 100000\n"}, 2),
        ({"cpu.max": "max 100000\n"}, 64),
        ({"cpu/cpu.cfs_quota_us": "50000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 1),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
        ({}, 64),
    ],
)
def test_a_containers_quota_limits_the_cores(files, most, tmp_path, monkeypatch):
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    monkeypatch.setattr(interrupts, "CGROUP", tmp_path)
    monkeypatch.setattr(interrupts.os, "sched_getaffinity", lambda _: range(64), raising=False)
    assert interrupts.cores() == most


def below(cause, error):
    """The error as it is raised from a cause."""
    error.__cause__ = cause
    return error


MAP = "libzstd.so.1: failed to map segment from shared object"
LACKS = [
    MemoryError(),
    OSError(errno.ENOMEM, "Cannot allocate memory"),
    pa.ArrowMemoryError("realloc of size 128 failed"),
    RuntimeError("can't start new thread"),
    ImportError(MAP),
    RuntimeError("std::bad_alloc"),
    below(OSError(MAP), NotARun("poses.parquet", "is damaged")),
]
SOUNDS = [
    None,
    OSError(errno.ENOSPC, "No space left on device"),
    ImportError(f"{MAP}: Operation not permitted"),
    ImportError("libgomp.so.1: cannot allocate memory in static TLS block"),
    ZeroDivisionError("cannot allocate memory"),
]


@pytest.mark.parametrize("error", [*LACKS, *SOUNDS], ids=repr)
def test_lack_of_memory_is_recognised_in_whatever_form_and_nothing_else(error):
    assert is_out_of_memory(error) == (error in LACKS)


def compile_something() -> None:
    njit(lambda x: x + 1)(1)


def test_the_first_compilation_is_said_once_and_is_no_time_of_a_stage():
    said, counted = [], []
    shown = SimpleNamespace(say=said.append, compiled=counted.append)
    clock, before_s, began_s = StageClock(), start_up.seconds, time.perf_counter()
    with compilation(Config(), shown) as before, clock.stage("map"):
        before("map")
        compile_something()
        compile_something()
    compiled_s, whole_s = start_up.seconds - before_s, time.perf_counter() - began_s
    assert counted == [1, 2]
    assert said == [SAID]
    assert 0.01 < compiled_s < whole_s
    assert clock.seconds["map"] == pytest.approx(whole_s - compiled_s, abs=0.01)
