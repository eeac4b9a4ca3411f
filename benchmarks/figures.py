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

    @property
    def verdict(self) -> str:
        """Whether the limit was kept in this run."""
        if self.limit is None:
            return ""
        kept = self.value >= self.limit if self.at_least else self.value <= self.limit
        return "ok" if kept else "SHORT"


def print_figures(title: str, figures: Iterable[Figure]) -> None:
    """One line each, under the part's name."""
    print(f"\n{title.splitlines()[0]}", flush=True)
    for each in figures:
        limit = "" if each.limit is None else f"{'>=' if each.at_least else '<='} {each.limit:g}"
        line = f"  {each.name:<52} {each.value:>10.3f} {each.unit:<10} {limit:<10} {each.verdict:<6} {each.floor}"
        print(line.rstrip(), flush=True)


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


def run_apart(work: Callable[..., Result], *arguments: object) -> Result:
    """Call a function in a process of its own on one core: its memory must not count for processes started later."""
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=one_core) as other:
        return other.submit(work, *arguments).result()


def one_core() -> None:
    """Bind this process to one core, where the system allows it."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
