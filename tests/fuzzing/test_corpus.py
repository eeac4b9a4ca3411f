"""Every input that ever broke something; nightly also mutations of sound ones; `make fuzz` tries more."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"


def fuzzing(*arguments, folder=ROOT):
    # In a process of its own, because it limits its memory.
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "fuzzing", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_corpus_passes():
    files = sorted(CORPUS.glob("*/*"))
    assert sum(path.stat().st_size for path in files) < 1 << 20
    fuzzing("replay", *files)


@pytest.mark.nightly
def test_mutations_pass(tmp_path):
    fuzzing("--hypothesis", "--seconds", 100, folder=tmp_path)
