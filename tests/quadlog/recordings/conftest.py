"""Real recordings to be read, and limits of the process."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def edge_cases() -> Path:
    folder = os.environ.get("QUADLOG_DATASETS")
    if not folder:
        pytest.skip("QUADLOG_DATASETS is not set")
    return Path(folder) / "edge_cases"


@pytest.fixture
def limited() -> Iterator[Callable[[int, int], None]]:
    """Sets a soft limit of this process, for the test."""
    before: dict[int, tuple[int, int]] = {}

    def limit(which: int, most: int) -> None:
        before[which] = resource.getrlimit(which)
        resource.setrlimit(which, (most, before[which][1]))

    yield limit
    for which, limits in before.items():
        resource.setrlimit(which, limits)
