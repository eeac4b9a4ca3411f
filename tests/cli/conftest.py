"""Commands as a user types them: what they print, and how they exit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"
FOLLOW = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml")]


class Done(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def quadlog(capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Run a command in this process; gives its exit code and what it printed."""

    def call(*arguments: object) -> Done:
        capsys.readouterr()
        code = run([str(each) for each in arguments])
        return Done(code, *capsys.readouterr())

    return call


@pytest.fixture
def ok(quadlog: Callable[..., Done]) -> Callable[..., str]:
    """The stdout of a command that has to succeed."""

    def call(*arguments: object) -> str:
        done = quadlog(*arguments)
        assert done.code == 0, done.err
        return done.out

    return call


@pytest.fixture
def refused(quadlog: Callable[..., Done]) -> Callable[..., str]:
    """The stderr of a command that has to fail with this code: without results, in one line unless it is usage."""

    def call(code: int, *arguments: object) -> str:
        done = quadlog(*arguments)
        assert (done.code, done.out) == (code, ""), done
        assert "Traceback" not in done.err
        if not done.err.startswith("Usage:"):
            assert done.err.startswith("quadlog: ")
            assert done.err.count("\n") == 1
        return done.err

    return call


@pytest.fixture(scope="session")
def follow(once: Callable[[str, Callable[[Path], Path]], Path]) -> Path:
    """A run of half a second of the committed recording, up to its maps; not to be changed."""

    def make(folder: Path) -> Path:
        assert run(["replay", *FOLLOW, "-o", str(folder / "runs"), "--until", "map", "--duration", "0.5"]) == 0
        return folder / "runs" / "follow"

    return once("follow", make)
