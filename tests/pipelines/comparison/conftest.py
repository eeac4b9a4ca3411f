"""Small sources of questions: a second of the committed recording, and maps in files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOutcome, ReplayRequest


@pytest.fixture(scope="session")
def planned_run(follow_request: Callable[..., ReplayRequest], once: Callable[..., ReplayOutcome]) -> Path:
    """A run folder up to its stage `plan`; not to be changed."""

    def make(runs: Path) -> ReplayOutcome:
        return replay(replace(follow_request(runs / "follow", duration_s=1.0, until="plan"), plots=False), Silent())

    return once("planned", make).run


@pytest.fixture
def write_map(tmp_path: Path) -> Callable[..., Path]:
    def write(blocked: np.ndarray | list[str], name: str = "small.map") -> Path:
        """A MovingAI map of blocked (rows, cols), or of its lines."""
        if isinstance(blocked, np.ndarray):
            blocked = ["".join("@" if cell else "." for cell in row) for row in blocked]
        lines = ["type octile", f"height {len(blocked)}", f"width {len(blocked[0])}", "map", *blocked]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path / name

    return write


@pytest.fixture
def write_scen(tmp_path: Path) -> Callable[..., Path]:
    def write(shape: tuple[int, int], queries: list[tuple], name: str = "small.map.scen") -> Path:
        """Queries (start, goal, length) on a map of shape (rows, cols)."""
        rows, cols = shape
        lines = [
            f"0\tsmall.map\t{cols}\t{rows}\t{start[0]}\t{start[1]}\t{goal[0]}\t{goal[1]}\t{length}"
            for start, goal, length in queries
        ]
        (tmp_path / name).write_text("\n".join(["version 1", *lines]) + "\n")
        return tmp_path / name

    return write
