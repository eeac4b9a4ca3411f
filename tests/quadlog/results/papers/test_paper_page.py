from __future__ import annotations

import csv
import io

from markdown_it import MarkdownIt

from quadlog.results.papers.page import (
    FAST,
    OLD,
    Appendix,
    Erratum,
    csv_text,
    errata_text,
    latex_text,
    readme_text,
    section_text,
)
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, SavedTable, TablePicture, Verdict

ROWS = (
    PaperRow('length, "A|B" (m)', 1.2345678, 1.23, 1.2, 1.3, Verdict.YES, "as_is & 5 %"),
    PaperRow("time (s)", 1e-7, 2.0, None, None, Verdict.NO, "why\nnot"),
    PaperRow("bound (m)", -0.0),
)


def table(fast: bool = False) -> PaperTable:
    groups = (RowGroup("One_group", "How.", ROWS[:2]), RowGroup("Two", "", ROWS[2:]))
    picture = TablePicture("site", "An [alt]", "A *caption*", b"png")
    return PaperTable("planning-1", "Title & more", "About.", "3 seeds.", 0, fast, groups, (picture,), ("Erratum_1",))


def test_the_csv_file_has_the_columns_of_the_contract_and_reads_back():
    read = list(csv.DictReader(io.StringIO(csv_text(table()))))
    assert list(read[0]) == ["quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note"]
    assert [row["quantity"] for row in read] == [row.quantity for row in ROWS]
    assert list(read[0].values())[1:] == ["1.23", "1.23457", "1.2", "1.3", "0.0045678", "yes", "as_is & 5 %"]
    assert list(read[1].values())[1:] == ["2", "1e-07", "", "", "-2", "no", "why\nnot"]
    assert list(read[2].values())[1:] == ["", "0", "", "", "", "", ""]


def test_the_section_shows_everything():
    text = section_text(table())
    html = MarkdownIt("commonmark").enable("table").render(text)
    for expected in (
        "<h2>Title &amp; more</h2>",
        "<code>quadlog tables planning-1</code>",
        "3 seeds.",
        '<img src="planning-1-site.png" alt="An [alt]" />',
        "<em>A *caption*</em>",
        "<h3>One_group</h3>",
        "<td>length, &quot;A|B&quot; (m)</td>",
        '<td style="text-align:right">1.2 to 1.3</td>',
        "<td>✗ no</td>\n<td>why not</td>",
        "<li>Erratum_1</li>",
        '<a href="planning-1.csv">',
        '<a href="planning-1.tex">',
    ):
        assert expected in html
    assert html.count("<table>") == 2


def test_a_fast_run_says_so_on_the_page_and_in_latex():
    assert "fast run" not in section_text(table()).lower()
    assert "**A fast run" in section_text(table(fast=True))
    assert "--fast" in section_text(table(fast=True))
    assert "(fast run)" not in latex_text(table())
    assert latex_text(table(fast=True)).count("(fast run)") == 2


def test_latex_has_one_table_per_group():
    text = latex_text(table())
    assert text.count(r"\toprule") == 2
    assert r"\caption{Title \& more: One\_group}" in text
    assert r"\label{tab:planning-1-1}" in text
    assert r"\label{tab:planning-1-2}" in text
    assert "95 \\% interval" in text
    assert text.count(r"\begin{tabular}{@{}p{0.32\linewidth}rrrrl@{}}") == 2


def test_every_erratum_is_a_row_under_its_paper():
    errata = {"[A]": [Erratum("eq. 1", "|x| * y_i", "x", "Why.")], "[B]": [Erratum("eq. 2", "1", "2")]}
    page = MarkdownIt("commonmark").enable("table").render(errata_text(errata, 3))
    assert page.count("<h3>") == page.count("<table>") == 2
    assert "<td>|x| * y_i</td>\n<td>x</td>\n<td>Why.</td>" in page
    assert page.index("<h3>[A]</h3>") < page.index("eq. 1") < page.index("<h3>[B]</h3>") < page.index("eq. 2")


JUDGED = (
    PaperRow("a", 1.0, 1.0, reproduces=Verdict.YES),
    PaperRow("b", 1.0, 2.0, reproduces=Verdict.NO, note="Why."),
    PaperRow("c", 1.0, 2.0),
    PaperRow("d", 1.0),
    PaperRow("e", 3.0, 3.0, reproduces=Verdict.YES),
    PaperRow("f", 3.0, 3.0, 2.0, 4.0, Verdict.UNDECIDED),
    PaperRow("g", 3.0, 3.0, reproduces=Verdict.NOT_COMPARABLE),
)


def page_html(*tables: SavedTable) -> str:
    text = readme_text(tables, "code", [Appendix("All & errata", "- One.\n")])
    return MarkdownIt("commonmark").enable("table").render(text)


def test_the_summary_counts_what_reproduces_of_what_is_judged(saved):
    page = page_html(saved("planning-1", JUDGED), saved("foot_2", JUDGED[2:4]))
    assert "2 of 4 printed numbers and claims" in page
    first, second = (line for line in page.split("<tr>") if line.startswith('\n<td><a href="#'))
    assert '<a href="#planning-1">planning-1</a>' in first
    cells = "".join(f'<td style="text-align:right">{each}</td>\n' for each in ("2 of 4", 1, 1, 1, 7))
    assert cells in first
    assert "quadlog tables planning-1" in first
    assert '<a href="#foot_2">foot_2</a>' in second
    assert '<td style="text-align:right">none printed</td>\n<td style="text-align:right">0</td>' in second


def test_a_link_of_the_summary_leads_to_its_table(saved):
    page = page_html(saved("planning-1", JUDGED))
    assert page.index('<a id="planning-1"></a>') < page.index("<h2>Title of planning-1</h2>")
    assert page.index("<h2>Title of planning-1</h2>") < page.index("<h2>All &amp; errata</h2>")


def test_fast_tables_and_older_ones_are_named(saved):
    text = readme_text([saved("a", JUDGED), saved("b", JUDGED)], "code", [])
    assert FAST not in text
    assert OLD not in text
    text = readme_text(
        [saved("a", JUDGED, fast=True), saved("b", JUDGED, code="before"), saved("c", JUDGED)], "code", []
    )
    assert FAST in text
    assert f"{OLD} b.\n" in text
