"""Start-up: processor time of whole processes, in turn with a bare interpreter."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure

ROUNDS = 15
QUADLOG = str(Path(sys.executable).with_name("quadlog"))


def measure(_: Path) -> Iterator[Figure]:
    """`quadlog --help` against `python -c pass`, medians of pairs."""
    pairs = [(cpu_ms([QUADLOG, "--help"]), cpu_ms([sys.executable, "-c", "pass"])) for _ in range(ROUNDS)]
    click_ms = statistics.median(cpu_ms([sys.executable, "-c", "import click"]) for _ in range(ROUNDS))
    bare_ms = statistics.median(bare for _, bare in pairs)
    extra_ms = statistics.median(help_ms - bare for help_ms, bare in pairs)
    floor = f"floor: importing click alone is {click_ms - bare_ms:.0f} ms above"
    yield Figure("quadlog --help, above python -c pass", extra_ms, "ms cpu", 60, floor=floor)


def cpu_ms(command: list[str]) -> float:
    """Processor time of a whole process, its children included."""
    before = os.times()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    after = os.times()
    used_s = after.children_user - before.children_user + after.children_system - before.children_system
    return used_s * 1e3
