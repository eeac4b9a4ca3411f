from __future__ import annotations

import pytest

from quadlog.pipelines.tables.figure_index import SHOWN
from quadlog.pipelines.tables.registry import TABLES

FIGURES = {"[Following]": 18, "[Planning]": 21, "[Tracking]": 29, "[Foot]": 6}
NUMBERED = {"[Following]": 2, "[Planning]": 2, "[Tracking]": 5, "[Foot]": 2}
"""How many figures and tables each paper has."""


def numbers(paper: str, kind: str) -> list[int]:
    found = []
    for each in SHOWN[paper]:
        if each.kind.startswith(kind):
            first, _, last = each.numbers.partition("-")
            found += range(int(first), int(last or first) + 1)
    return found


@pytest.mark.parametrize("paper", FIGURES)
def test_every_table_and_figure_of_a_paper_is_there_once(paper):
    assert numbers(paper, "Fig") == list(range(1, FIGURES[paper] + 1))
    assert numbers(paper, "Table") == list(range(1, NUMBERED[paper] + 1))


def test_each_leads_to_a_table_there_is_or_says_why_not():
    everywhere = [each for mine in SHOWN.values() for each in mine]
    assert all(each.tables or each.remark for each in everywhere)
    # What real recordings give is in no paper.
    assert {name for each in everywhere for name in each.tables} == set(TABLES) - {"uwb-real"}
