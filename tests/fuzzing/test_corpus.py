"""Every input that ever broke something, and a few mutations of sound ones; `make fuzz` tries more."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"
OF_RECORDINGS = ("containers", "damage", "split", "definitions", "payloads", "web", "urls")
OF_FILES = ("toml", "maps", "lines", "models", "run-files", "run-values", "pages")


@pytest.mark.parametrize("targets", [OF_RECORDINGS, OF_FILES], ids=["recordings", "files"])
def test_the_corpus_and_a_few_mutations_pass(targets):
    # In a process of its own, because it limits its memory.
    command = [sys.executable, "-m", "fuzzing", "test", str(CORPUS), *targets]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr


def test_the_corpus_stays_small_and_all_of_it_is_replayed():
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 1 << 20
    assert {path.parent.name for path in files} <= {*OF_RECORDINGS, *OF_FILES}


def test_every_target_is_tested():
    table = (ROOT / "fuzzing" / "targets" / "table.py").read_text()
    assert set(re.findall(r'^    "([a-z-]+)": Target\(', table, re.MULTILINE)) == {*OF_RECORDINGS, *OF_FILES}
