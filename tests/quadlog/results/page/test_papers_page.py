"""The page of the papers' tables: printed values and claims beside measured ones, verdicts in words and colours."""

from __future__ import annotations

import html
import re

import pytest

from quadlog.results.page.blocks import render
from quadlog.results.page.papers import papers_page
from quadlog.results.papers.table import Origin, PaperRow, PaperTable, RowGroup, SavedTable, Verdict

HOSTILE = "</td><script>alert(1)</script>"
ROWS = (
    PaperRow("e", 7.0),
    PaperRow("a (m)", 1.23456789, 1.2, 1.0, 1.5, Verdict.YES),
    PaperRow(f"b {HOSTILE}", -0.25, 0.75, -0.5, 0.0, Verdict.NO, HOSTILE),
    PaperRow("c", 3.0, 3.0, 2.0, 4.0, Verdict.UNDECIDED),
    PaperRow("d", 3.0, 3.0, reproduces=Verdict.NOT_COMPARABLE),
    PaperRow("f (1)", 14.49, 5.0, 12.0, 16.0, Verdict.YES, claim="> 5", of="a (m)"),
)


def saved(name: str, rows: tuple[PaperRow, ...], code: str = "code", fast: bool = False) -> SavedTable:
    groups = (RowGroup("Judged", "Text.", rows), RowGroup("Unprinted", "", (PaperRow("g", 1.0),)))
    table = PaperTable(name, f"Title of {name}", "The `cap`.", "Sizes.", 0, fast, groups)
    return SavedTable(table, Origin(code, fast, 0))


@pytest.fixture(scope="module")
def page() -> str:
    tables = [saved("one", ROWS), saved("two", ROWS[1:2], code="before", fast=True)]
    return render(papers_page(tables, "code")).decode()


def rows_of(page: str, table: str) -> list[list[str]]:
    found = re.search(rf'<table id="{table}">.*?<tbody>(.*?)</tbody>', page, re.DOTALL)
    assert found is not None
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", found[1], re.DOTALL)
    return [[html.unescape(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in rows]


def test_what_the_paper_prints_comes_first_with_its_verdict_and_the_rest_on_demand(page: str) -> None:
    rows = rows_of(page, "one-0")
    assert rows[0] == ["a (m)", "1.2", "1.235", "1 to 1.5", "yes", ""]
    assert rows[1] == [f"b {HOSTILE}", "0.75", "−0.25", "−0.5 to 0", "no", HOSTILE]
    assert [row[4] for row in rows] == ["yes", "no", "undecided", "not comparable", "yes", ""]
    assert [row[:3] for row in rows[4:]] == [["f (1)", "> 5", "14.49"], ["e", "", "7"]]
    assert page.count('<tr class="folded">') == 1
    assert "Unprinted: 1 quantities that the paper does not print" in page


def test_the_top_counts_verdicts_worst_first_and_names_what_is_not_current(page: str) -> None:
    top = page[: page.index('id="one"')]
    found = re.findall(r'<div class="(\w*)"><dt>([\w ]+)</dt><dd>(\d+ of \d+ claims)', top)
    assert found == [
        ("bad", "Do not", "1 of 5 claims"),
        ("warn", "Undecided", "1 of 5 claims"),
        ("good", "Reproduce", "2 of 5 claims"),
        ("", "Not comparable", "1 of 5 claims"),
    ]
    assert "wider intervals than the full tables: two." in top
    assert "than the last table: two." in top
    assert [row[-1] for row in rows_of(page, "tables")] == ["7", "2"]


def test_names_are_text_and_pictures_are_inside(page: str) -> None:
    assert "<script>alert" not in page
    assert page.count('src="data:image/png;base64,') == 2
    assert "The cap." in page
