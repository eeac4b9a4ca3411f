from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.results.compare.table_diff import match_rows

ROWS = st.lists(st.tuples(st.integers(-3, 3), st.integers(0, 2), st.sampled_from(["fixes", "track"])), max_size=30)


def columns(rows: list[tuple[int, int, str]]) -> list[np.ndarray[Any, Any]]:
    return [np.array([row[k] for row in rows], kind) for k, kind in enumerate((np.int64, np.int64, object))]


def numbered(rows: list[tuple[int, int, str]]) -> pd.DataFrame:
    frame = pd.DataFrame(rows, columns=["t_ns", "tag", "source"])
    frame["n"] = frame.groupby(["t_ns", "tag", "source"]).cumcount() if rows else []
    return frame.assign(row=np.arange(len(rows))).astype({"t_ns": int, "tag": int, "source": object, "n": int})


@settings(max_examples=200, deadline=None)
@given(ROWS, ROWS)
def test_rows_are_matched_as_pandas_merges_them(a: list[Any], b: list[Any]) -> None:
    match = match_rows(columns(a), columns(b))
    merged = (
        numbered(a).merge(numbered(b), on=["t_ns", "tag", "source", "n"], suffixes=("_a", "_b")).sort_values("row_a")
    )
    assert match.a.tolist() == merged["row_a"].tolist()
    assert match.b.tolist() == merged["row_b"].tolist()
    assert match.only_a.tolist() == sorted(set(range(len(a))) - set(match.a.tolist()))
    assert match.only_b.tolist() == sorted(set(range(len(b))) - set(match.b.tolist()))


def test_wide_keys_do_not_overflow() -> None:
    wide = np.array([-(2**63), 2**63 - 1, 0], np.int64)
    match = match_rows([wide, wide], [wide[::-1], wide[::-1]])
    assert match.b.tolist() == [2, 1, 0]
