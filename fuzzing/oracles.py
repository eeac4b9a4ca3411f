"""What must hold for every input: a documented outcome, within bounded time and memory."""

from __future__ import annotations

import contextlib
import io
import resource
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType

from quadlog.errors import ExitCode, QuadlogError

_ADDRESS_SPACE_BYTES = 1 << 30


class Finding(BaseException):
    """An input that broke an oracle. No Exception, so that no handler of quadlog's takes it for damage."""


def check(case: Callable[[bytes], None], data: bytes, most_cpu_s: float) -> None:
    """Run one case; raises Finding, or whatever the case let through that is no QuadlogError.

    Time is the process's CPU time, so that a busy machine finds nothing. Warnings are errors: on a user's terminal
    they would be noise.
    """
    signal.setitimer(signal.ITIMER_PROF, most_cpu_s)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", ResourceWarning)  # raised in a destructor, it has no way out
            case(data)
    except QuadlogError as error:
        _expect_short(str(error))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def limit_process() -> None:
    """Interrupt cases that take too long and deny more memory. Call it once, after the imports."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise Finding("takes too long")

    signal.signal(signal.SIGPROF, interrupt)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(OSError):  # no Linux: memory is not limited
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + _ADDRESS_SPACE_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def command(*arguments: str | Path, allowed: Sequence[ExitCode]) -> tuple[ExitCode, str]:
    """Run one command line in this process; its exit code, which must be one of those allowed, and its stdout."""
    from quadlog.cli.main import run

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = ExitCode(run([str(argument) for argument in arguments]))
    expect(code in allowed, f"{arguments[0]} exits with {code!r}: {err.getvalue()[:500]}")
    for line in err.getvalue().splitlines():
        _expect_short(line)
    return code, out.getvalue()


def expect(holds: bool, what: str) -> None:
    """Raise a Finding unless it holds."""
    if not holds:
        raise Finding(what)


def _expect_short(text: str) -> None:
    expect(len(text) <= 20_000, f"a message of {len(text)} characters: {text[:200]}")


@contextlib.contextmanager
def replaced(path: Path, content: bytes) -> Iterator[None]:
    """The file with another content, while the block lasts."""
    before = path.read_bytes() if path.exists() else None
    path.write_bytes(content)
    try:
        yield
    finally:
        path.unlink()
        if before is not None:
            path.write_bytes(before)
