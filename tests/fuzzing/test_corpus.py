"""Every input that ever broke something, and a few mutations of sound ones; `make fuzz` tries more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"
EXAMPLES = {"split": 20, "maps": 60, "models": 60, "run-files": 20, "run-values": 15, "web": 60}


def fuzzed(*arguments: str) -> subprocess.CompletedProcess[str]:
    """In a process of its own, because it limits its memory."""
    command = [sys.executable, "-m", "fuzzing", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)


@pytest.mark.parametrize(
    "target",
    [
        *("containers", "damage", "split", "definitions", "payloads", "web", "urls", "toml", "maps", "lines", "models"),
        *("run-files", "run-values"),
    ],
)
def test_what_was_found_once_stays_mended(target):
    found = [str(CORPUS / target)] if (CORPUS / target).is_dir() else []
    done = fuzzed("replay", target, *found, "--examples", str(EXAMPLES.get(target, 100)))
    assert done.returncode == 0, done.stderr


def test_the_corpus_stays_small_and_belongs_to_targets_that_are_replayed():
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 1 << 20
    (mark,) = test_what_was_found_once_stays_mended.pytestmark
    assert {path.parent.name for path in files} <= set(mark.args[1])
