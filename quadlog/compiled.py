"""How hot loops are compiled with numba, so that the first start stays short: one decorator for each kind of caller.

Much of the time that a small function takes to compile goes into what is around it: the wrappers for its callers, and
optimising it by itself and once more in each compiled caller.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any

from numba import njit
from numba.extending import register_jitable

# Options that numba has and its type hints do not.
_NO_CFUNC: dict[str, Any] = {"no_cfunc_wrapper": True}


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Numba's njit with these options; what it compiles is kept for the next start if any folder can be written to."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = njit(**options)(function)
        try:
            dispatcher.enable_caching()
        except RuntimeError:  # numba found no folder
            _say_that_nothing_is_kept()
        return dispatcher

    return compiled


@cache
def _say_that_nothing_is_kept() -> None:
    text = "compiled code cannot be kept, so that every start compiles it; set NUMBA_CACHE_DIR to a writable folder"
    sys.stderr.write(f"warning: {text}\n")


def kernel(function: Callable[..., Any]) -> Any:
    """Called from Python, in several threads at once, and by other compiled functions too."""
    return cached(error_model="numpy", nogil=True, **_NO_CFUNC)(function)


def inner(function: Callable[..., Any]) -> Any:
    """Called by compiled functions, at several places or at length; to Python it stays the plain function it is.

    A wrapper-less njit would do as well, but Python crashes when it calls one.
    """
    return register_jitable(error_model="numpy", no_cpython_wrapper=True, **_NO_CFUNC)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Put into its compiled caller before that is typed: for few lines. Python calls it as it calls a kernel."""
    return cached(error_model="numpy", inline="always", **_NO_CFUNC)(function)
