"""A small table of a paper, as it is saved."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from quadlog.results.papers.table import Origin, PaperRow, PaperTable, RowGroup, SavedTable, Verdict

ROWS = (PaperRow("a (m)", 0.1 + 0.2, 1 / 3, 0.1, 0.7, Verdict.NO, "why\nnot ✗ \u2028"), PaperRow("b", -0.0))


@pytest.fixture(scope="session")
def saved() -> Callable[..., SavedTable]:
    """Makes a table of these rows in one group, and its origin."""

    def saved(
        name: str = "one", rows: Sequence[PaperRow] = ROWS, *, code: str = "code", fast: bool = False, seed: int = 0
    ) -> SavedTable:
        group = RowGroup("Group", "Text.", tuple(rows))
        table = PaperTable(name, f"Title of {name}", "Caption.", "Sizes.", seed, fast, (group,))
        return SavedTable(table, Origin(code, fast, seed), [{"seed": 3, "m": 0.1 + 0.2}])

    return saved
