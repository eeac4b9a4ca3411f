"""Lack of memory, which hardly anything that meets it calls by its name."""

from __future__ import annotations

import errno

_WORDS = (
    *("cannot allocate memory", "can't start new thread", "failed to map segment", "cannot map zero-fill pages"),
    *("cannot create shared object descriptor", "bad_alloc"),
)
"""Of the C library, its loader, Python's threads and C++. Which exception has them is up to who passes them on."""
_OTHER_CAUSES = ("static tls block", "operation not permitted", "permission denied")
"""With these, memory is there: a library that came too late for its place, and a disk nothing may be run from."""


def is_out_of_memory(error: BaseException | None) -> bool:
    """Whether lack of memory is the error, what caused it, or what was being handled when it came."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or _tells_of_it(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _tells_of_it(error: BaseException) -> bool:
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    told = str(error).lower() if isinstance(error, ImportError | OSError | RuntimeError) else ""
    return any(words in told for words in _WORDS) and not any(words in told for words in _OTHER_CAUSES)
