from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.errors import TooLarge
from quadlog.results.compare import table_diff
from quadlog.results.compare.table_diff import match_rows

ROWS = st.lists(st.tuples(st.integers(-3, 3), st.integers(0, 2), st.sampled_from(["fixes", "track"])), max_size=30)


def columns(rows: list[tuple[int, int, str]]) -> dict[str, Any]:
    kinds = {"t_ns": np.int64, "tag": np.int64, "source": object}
    return {name: np.array([row[k] for row in rows], kind) for k, (name, kind) in enumerate(kinds.items())}


@settings(max_examples=200, deadline=None)
@given(ROWS, ROWS)
def test_of_rows_with_one_key_the_first_belongs_to_the_first(a: list[Any], b: list[Any]) -> None:
    match = match_rows("x", columns(a), columns(b))
    left = list(enumerate(b))
    wanted, only_a = [], []
    for i, key in enumerate(a):
        found = next((each for each in left if each[1] == key), None)
        if found is None:
            only_a.append(i)
        else:
            left.remove(found)
            wanted.append((i, found[0]))
    assert list(zip(match.a.tolist(), match.b.tolist(), strict=True)) == wanted
    assert match.only_a.tolist() == only_a
    assert match.only_b.tolist() == [k for k, _ in left]


def test_wide_keys_do_not_overflow() -> None:
    wide = np.array([-(2**63), 2**63 - 1, 0], np.int64)
    assert match_rows("x", {"a": wide, "b": wide}, {"a": wide[::-1], "b": wide[::-1]}).b.tolist() == [2, 1, 0]


def test_too_many_rows_are_not_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_diff, "MAX_ROWS_AT_ONCE", 2)
    rows = np.arange(3)
    assert match_rows("x", {"t_ns": rows}, {"t_ns": rows}).a.tolist() == [0, 1, 2]
    with pytest.raises(TooLarge, match="x: rows to compare at once: 3"):
        match_rows("x", {"t_ns": rows}, {"t_ns": rows[:2]})
