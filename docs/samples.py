"""Writes the printed samples of README and tutorial again, by typing their commands; `make docs` does it, too.

A sample shows some of the lines that its commands print: it keeps the same ones, with the numbers of today; an
ellipsis stays one.
"""

from __future__ import annotations

import io
import re
import shlex
import tempfile
from contextlib import chdir, redirect_stdout
from itertools import groupby, pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("docs/tutorial.md", "README.md")
FIXTURE = "replay fixtures/follow.mcap -c fixtures/follow.toml --force"
_BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_NUMBER = re.compile(r"[(±+−-]*\d[\d.]*[)%,.;:]*|\d+\.\.\d+")


def update_samples() -> None:
    """Replay the committed recording in a new folder and write both pages; SystemExit for a command that fails."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        Path("fixtures").symlink_to(ROOT / "fixtures")
        _typed(FIXTURE)
        for page in PAGES:
            text = (ROOT / page).read_text(encoding="utf-8")
            (ROOT / page).write_text(_updated(text), encoding="utf-8")


def _updated(text: str) -> str:
    """The page with the lines that the commands before each sample print."""
    blocks, parts, end = list(_BLOCK.finditer(text)), [], 0
    for before, block in pairwise(blocks):
        if block[1] == "text" and before[1] == "sh":
            commands = [line.partition("  #")[0] for line in before[2].splitlines()]
            printed = "".join(_typed(line.removeprefix("quadlog ")) for line in commands)
            parts += [text[end : block.start(2)], fill(block[2], printed)]
            end = block.end(2)
    return "".join([*parts, text[end:]])


def _typed(line: str) -> str:
    from quadlog.cli.main import run

    printed = io.StringIO()
    with redirect_stdout(printed):
        code = run(shlex.split(line))
    if code not in (0, 3):
        raise SystemExit(f"quadlog {line}: exit code {code}")
    return printed.getvalue()


def fill(sample: str, printed: str) -> str:
    """The lines of a sample as they were printed, in this order; raises SystemExit for one that was not."""
    rows, filled = printed.splitlines(), []
    for line in sample.splitlines():
        if not line:
            filled.append(line)
            continue
        at = next((at for at, row in enumerate(rows) if _words(row) == _words(line)), None)
        if at is None and "…" in line:
            at = next((at for at, row in enumerate(rows) if _words(row)[:1] == _words(line)[:1]), None)
        if at is None:
            raise SystemExit(f"not printed any more: {line}")
        filled.append(_cut(line, rows[at]))
        rows = rows[at + 1 :]
    return "".join(f"{line.rstrip()}\n" for line in filled)


def _words(line: str) -> list[str]:
    """Its words, of numbers that there are some."""
    return [word for word, _ in groupby("#" if _NUMBER.fullmatch(word) else word for word in line.split())]


def _cut(line: str, row: str) -> str:
    """The printed row with the words of the sample that are an ellipsis."""
    words = list(re.finditer(r"\S+", row))
    for old, new in zip(reversed(line.split()), reversed(words), strict=False):
        if old == "…":
            row = f"{row[: new.start()]}{'…':<{len(new[0])}}{row[new.end() :]}"
    return row


if __name__ == "__main__":
    update_samples()
