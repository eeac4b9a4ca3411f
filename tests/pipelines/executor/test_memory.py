from __future__ import annotations

import errno

import pyarrow as pa
import pytest

from quadlog.errors import NotARun
from quadlog.pipelines.executor.machine import is_out_of_memory


def below(cause, error):
    """The error as it is raised from a cause."""
    error.__cause__ = cause
    return error


def after(other, error):
    """The error as it is raised while another one is handled."""
    error.__context__ = other
    return error


MAP = "libzstd.so.1: failed to map segment from shared object"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        pa.ArrowMemoryError("realloc of size 128 failed"),
        RuntimeError("can't start new thread"),
        ImportError(MAP),
        OSError(MAP),
        OSError("liba.so: cannot allocate memory"),
        RuntimeError("std::bad_alloc"),
        below(pa.ArrowMemoryError("realloc of size 128 failed"), NotARun("poses.parquet", "is damaged")),
        after(OSError(MAP), OSError("Could not find/load shared object file 'libllvmlite.so'")),
        below(None, after(below(MemoryError(), ValueError()), ImportError("numba needs llvmlite"))),
    ],
    ids=repr,
)
def test_lack_of_memory_is_recognised_in_whatever_form(error):
    assert is_out_of_memory(error)


@pytest.mark.parametrize(
    "error",
    [
        None,
        OSError(errno.ENOSPC, "No space left on device"),
        ImportError("No module named 'quadlog'"),
        ImportError(f"{MAP}: Operation not permitted"),
        ImportError("libgomp.so.1: cannot allocate memory in static TLS block"),
        NotARun("poses.parquet", "is damaged or no table"),
        ZeroDivisionError("cannot allocate memory"),
    ],
    ids=repr,
)
def test_what_only_sounds_like_it_is_not(error):
    assert not is_out_of_memory(error)


def test_a_ring_of_errors_has_an_end():
    one = ValueError()
    one.__context__ = below(one, KeyError())
    assert not is_out_of_memory(one)
