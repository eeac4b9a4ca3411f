"""A measured figure with its limit and its floor, and how commands and functions are timed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple, TypeVar

QUADLOG = str(Path(sys.executable).with_name("quadlog"))
FIXTURE, CONFIG = (Path(__file__).parents[1] / "fixtures" / f"follow.{end}" for end in ("mcap", "toml"))
Result = TypeVar("Result")


class Figure(NamedTuple):
    """limit: what it must not exceed, or fall short of when at_least; floor: what no code could beat here."""

    name: str
    value: float
    unit: str
    limit: float | None = None
    at_least: bool = False
    floor: str = ""

    def __str__(self) -> str:
        limit = verdict = ""
        if self.limit is not None:
            limit = f"{'>=' if self.at_least else '<='} {self.limit:g}"
            kept = self.value >= self.limit if self.at_least else self.value <= self.limit
            verdict = "ok" if kept else "SHORT"
        return f"  {self.name:<52} {self.value:>10.3f} {self.unit:<10} {limit:<10} {verdict:<6} {self.floor}"


def print_figures(title: str, figures: Iterable[Figure | str]) -> None:
    """One line each, under the part's name."""
    print(f"\n{title.strip()}", flush=True)
    for each in figures:
        print(str(each).rstrip(), flush=True)


class Seconds(NamedTuple):
    """Wall and processor time."""

    wall: float
    cpu: float


def run_timed(command: Sequence[str], environ: dict[str, str] | None = None) -> Seconds:
    """Run a process to its end; its children count as well."""
    before, began = os.times(), time.perf_counter()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run(command, env=environ, check=True, **quiet)
    wall, after = time.perf_counter() - began, os.times()
    cpu = after.children_user - before.children_user + after.children_system - before.children_system
    return Seconds(wall, cpu)


def run_quadlog(*words: str) -> Seconds:
    """Run a quadlog command."""
    return run_timed([QUADLOG, *words])


def run_python(code: str) -> Seconds:
    """Run a Python program: what imports alone take."""
    return run_timed([sys.executable, "-c", code])


def synthesize(folder: Path, duration_s: int, azimuth_steps: int) -> tuple[Path, Path]:
    """A walk of the scenario follow with so many points a scan (16 times the steps), and its configuration."""
    folder.mkdir(exist_ok=True)
    path, config = folder / f"follow-{duration_s}.mcap", folder / "quadlog.toml"
    size = ("--duration", str(duration_s), "--azimuth-steps", str(azimuth_steps), "--force")
    run_quadlog("synthesize", "follow", *size, "-o", str(path), "--config-output", str(config))
    return path, config


def run_apart(work: Callable[..., Result], *arguments: object) -> Result:
    """Call a function in a process of its own on one core: its memory must not count for processes started later."""
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=one_core) as other:
        return other.submit(work, *arguments).result()


def one_core() -> None:
    """Bind this process to one core, where the system allows it."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
