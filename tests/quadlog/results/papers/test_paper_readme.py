from __future__ import annotations

from markdown_it import MarkdownIt

from quadlog.results.papers.page import FAST, OLD, Appendix, readme_text
from quadlog.results.papers.table import Origin, PaperRow, PaperTable, RowGroup, SavedTable

JUDGED = (
    PaperRow("a", 1.0, 1.0, reproduces=True),
    PaperRow("b", 1.0, 2.0, reproduces=False, note="Why."),
    PaperRow("c", 1.0, 2.0),
    PaperRow("d", 1.0),
    PaperRow("e", 3.0, 3.0, reproduces=True),
)


def saved(name: str, rows=JUDGED, fast: bool = False, code: str = "code") -> SavedTable:
    table = PaperTable(name, f"Title of {name}", "", "3 seeds.", 0, fast, (RowGroup("Group", "", tuple(rows)),))
    return SavedTable(table, Origin(code, fast, 0))


def html(*tables: SavedTable) -> str:
    text = readme_text(tables, "code", [Appendix("All & errata", "- One.\n")])
    return MarkdownIt("commonmark").enable("table").render(text)


def test_the_summary_counts_what_reproduces_of_what_is_judged():
    page = html(saved("planning-1"), saved("foot_2", JUDGED[2:4]))
    assert "2 of 3 printed numbers and claims" in page
    first, second = (line for line in page.split("<tr>") if line.startswith('\n<td><a href="#'))
    assert '<a href="#planning-1">planning-1</a>' in first
    assert '<td style="text-align:right">2 of 3</td>\n<td style="text-align:right">5</td>' in first
    assert "quadlog tables planning-1" in first
    assert '<a href="#foot_2">foot_2</a>' in second
    assert '<td style="text-align:right">none printed</td>\n<td style="text-align:right">2</td>' in second


def test_a_link_of_the_summary_leads_to_its_table():
    page = html(saved("planning-1"))
    assert page.index('<a id="planning-1"></a>') < page.index("<h2>Title of planning-1</h2>")
    assert page.index("<h2>Title of planning-1</h2>") < page.index("<h2>All &amp; errata</h2>")


def test_fast_tables_and_older_ones_are_named():
    text = readme_text([saved("a"), saved("b")], "code", [])
    assert FAST not in text
    assert OLD not in text
    text = readme_text([saved("a", fast=True), saved("b", code="before"), saved("c")], "code", [])
    assert FAST in text
    assert f"{OLD} b.\n" in text


def test_the_page_explains_its_columns():
    text = readme_text([], "code", [])
    for word in ("**paper**", "**95 % interval**", "**reproduces**"):
        assert word in text
    assert "0 of 0" in text
