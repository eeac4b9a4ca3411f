from __future__ import annotations

import pytest

from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup


def table(*groups: RowGroup, fast: bool = False, seed: int = 0) -> PaperTable:
    return PaperTable("planning-1", "Title", "Caption", "3 seeds.", seed, fast, groups)


def test_the_difference_is_ours_less_the_papers():
    assert PaperRow("a (m)", 1.5, 2.0).difference == -0.5
    assert PaperRow("a (m)", 1.5).difference is None


@pytest.mark.parametrize(
    "numbers",
    [{"ours": float("nan")}, {"ours": 1.0, "paper": float("inf")}, {"ours": 1.0, "low": 0.5}],
)
def test_what_is_no_number_never_becomes_a_row(numbers):
    with pytest.raises(AssertionError):
        PaperRow("a (m)", **numbers)


def test_rows_are_those_of_all_groups_and_named_once():
    first, second = PaperRow("a", 1.0), PaperRow("b", 2.0)
    groups = RowGroup("x", "", (first,)), RowGroup("y", "", (second,))
    assert table(*groups).rows == (first, second)
    with pytest.raises(AssertionError, match="quantity"):
        table(groups[0], groups[0])


def test_what_can_be_judged_is_counted():
    rows = PaperRow("a", 1.0, 1.0, reproduces=True), PaperRow("b", 1.0, 2.0, reproduces=False), PaperRow("c", 1.0, 2.0)
    assert table(RowGroup("x", "", rows)).judged == rows[:2]
    assert table(RowGroup("x", "", rows)).reproduced == "1 of 2 printed numbers reproduce"
    assert table(RowGroup("x", "", rows[2:])).reproduced == "the paper prints none"


def test_the_command_says_what_differs_from_the_defaults():
    assert table().command == "quadlog tables planning-1"
    assert table(fast=True, seed=7).command == "quadlog tables planning-1 --fast --seed 7"
