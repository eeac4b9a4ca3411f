"""What must hold for every input: a documented outcome, within bounded time and memory."""

from __future__ import annotations

import contextlib
import io
import resource
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import process_time
from types import FrameType

from quadlog.errors import ExitCode, QuadlogError
from quadlog.pipelines.executor.progress import peak_memory_mb

MOST_GROWTH_BYTES = 500 << 20
_ADDRESS_SPACE_BYTES = 3 << 30
_PAGE_BYTES = resource.getpagesize()


class Finding(BaseException):
    """An input that broke an oracle. No Exception, so that no handler of quadlog's takes it for damage."""


def check(case: Callable[[bytes], None], data: bytes, most_cpu_s: float) -> None:
    """Run one case; raises Finding, or whatever the case let through that is no QuadlogError.

    Time is the process's CPU time, so that a busy machine finds nothing; memory is how far the peak lies above what
    the process held before. Warnings are errors: on a user's terminal they would be noise.
    """
    held_bytes, started_s = _resident_bytes(), process_time()
    signal.setitimer(signal.ITIMER_PROF, most_cpu_s)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", ResourceWarning)  # raised in a destructor, it has no way out
            case(data)
    except QuadlogError as error:
        _expect_one_line(str(error))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    if (took_s := process_time() - started_s) > most_cpu_s:
        raise Finding(f"took {took_s:.1f} s of CPU time")
    if (grown := _peak_bytes() - held_bytes) > MOST_GROWTH_BYTES and _peak_bytes() > _Peak.before:
        raise Finding(f"needed {grown >> 20} MB")
    _Peak.before = max(_Peak.before, _peak_bytes())


def limit_process() -> None:
    """Put this process under the limits that check() relies on. Call it once, after the imports."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise Finding("takes too long")

    signal.signal(signal.SIGPROF, interrupt)
    most = _virtual_bytes() + _ADDRESS_SPACE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _Peak.before = _peak_bytes()


def command(*arguments: str | Path, allowed: Sequence[ExitCode]) -> tuple[ExitCode, str]:
    """Run one command line in this process; its exit code, which must be one of those allowed, and its stdout."""
    from quadlog.cli.main import run

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = ExitCode(run([str(argument) for argument in arguments]))
    if code not in allowed:
        raise Finding(f"{arguments[0]} exits with {code!r}: {err.getvalue()[:500]}")
    if code is ExitCode.FAILED:
        _expect_one_line(err.getvalue().strip().rpartition("\n")[2])
    for line in err.getvalue().splitlines():
        _expect_one_line(line)
    return code, out.getvalue()


def expect(holds: bool, what: str) -> None:
    """Raise a Finding unless it holds."""
    if not holds:
        raise Finding(what)


def _expect_one_line(text: str) -> None:
    """A message is for a terminal: one line of bounded length."""
    expect(len(text) <= 20_000, f"a message of {len(text)} characters: {text[:200]}")


class _Peak:
    before = 0


def _peak_bytes() -> int:
    # The peak of getrusage includes that of the parent process.
    return int(peak_memory_mb() * 1e6)


def _statm() -> list[int]:
    try:
        return [int(pages) * _PAGE_BYTES for pages in Path("/proc/self/statm").read_text().split()[:2]]
    except OSError:  # no Linux: the peak is measured from the peak, and the address space is left alone
        return [1 << 60, _peak_bytes()]


def _resident_bytes() -> int:
    return _statm()[1]


def _virtual_bytes() -> int:
    return _statm()[0]


@contextlib.contextmanager
def replaced(path: Path, content: bytes) -> Iterator[Path]:
    """The file with another content, while the block lasts."""
    before = path.read_bytes() if path.exists() else None
    path.write_bytes(content)
    try:
        yield path
    finally:
        if before is None:
            path.unlink(missing_ok=True)
        else:
            path.write_bytes(before)
