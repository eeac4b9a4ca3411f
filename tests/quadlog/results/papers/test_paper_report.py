"""report.html of the papers' tables: what the saved tables hold, in words and colours, within a bound."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from quadlog.errors import AlreadyExists
from quadlog.results.papers import report
from quadlog.results.papers.page import Appendix, AppendixTable, write_table
from quadlog.results.papers.report import RelatedPage, write_report
from quadlog.results.papers.table import PaperRow, SavedTable, Verdict

Saved = Callable[..., SavedTable]
HOSTILE = "</td><script>alert(1)</script>"
ROWS = (
    PaperRow("a (m)", 1.23456789, 1.2, 1.0, 1.5, Verdict.YES),
    PaperRow(f"b {HOSTILE}", -0.25, 0.75, -0.5, 0.0, Verdict.NO, HOSTILE),
    PaperRow("c", 3.0, 3.0, 2.0, 4.0, Verdict.UNDECIDED),
    PaperRow("d", 3.0, 3.0, reproduces=Verdict.NOT_COMPARABLE),
    PaperRow("e", 7.0),
)
RELATED = {"two": RelatedPage("Paths", "quadlog compare-planners forest:0.1 -o planners", "planners")}
APPENDICES = [Appendix("Errata", "As `printed`.\n", [AppendixTable("[A]", ("where", "right"), [("eq. 1", HOSTILE)])])]


def written(folder: Path, force: bool = False) -> str:
    return write_report(folder, ["one", "two"], "code", APPENDICES, RELATED, force).read_text()


@pytest.fixture
def folder(tmp_path: Path, saved: Saved) -> Path:
    write_table(tmp_path, saved("one", ROWS))
    write_table(tmp_path, saved("two", ROWS[:1], code="before", fast=True))
    return tmp_path


def test_every_row_has_both_numbers_and_its_verdict_in_a_word(folder: Path) -> None:
    page = written(folder)
    rows = re.findall(r'<tr><th scope="row" class="quantity">(.*?)</tr>', page)
    assert len(rows) == len(ROWS) + 1
    looks = {Verdict.YES: "good", Verdict.NO: "bad", Verdict.UNDECIDED: "warn", Verdict.NOT_COMPARABLE: "none"}
    for text, row in zip(rows, (*ROWS, ROWS[0]), strict=True):
        numbers = [float(value) for value in re.findall(r'<data value="([^"]*)">', text)]
        assert numbers == ([] if row.paper is None else [row.paper]) + [row.ours]
        told = re.search(r'<td class="state (\w+)"[^>]*>(.*?)</td>', text)
        assert told is not None
        if row.reproduces is not None:
            assert told[1] == looks[row.reproduces]
            assert told[2].split(" ", 1)[1] == str(row.reproduces)
        assert html.unescape(text).endswith(f"{row.note}</td>")
    assert "1 to 1.5" in rows[0]


def test_the_top_counts_verdicts_and_names_what_is_not_current(folder: Path) -> None:
    top = written(folder).split("<main>")[0]
    assert "<strong>2 of 4</strong> printed numbers and claims" in top
    assert re.findall(r'<dd class="state (\w+)">(\S+) (\d+)</dd>', top) == [
        ("good", "✓", "2"),
        ("bad", "✗", "1"),
        ("warn", "?", "1"),
        ("none", "–", "1"),
    ]
    assert "wider intervals than the full tables: two." in top
    assert "than the last table here: two." in top


def test_names_are_text(folder: Path) -> None:
    page = written(folder)
    assert "<script" not in page
    assert page.count(html.escape(HOSTILE, quote=False)) == 3


def test_the_page_of_planners_is_linked_once_it_is_there(folder: Path) -> None:
    before = written(folder)
    assert "quadlog compare-planners forest:0.1 -o planners" in before
    assert 'href="./planners/report.html"' not in before
    (folder / "planners").mkdir()
    (folder / "planners" / "report.html").write_text("page")
    with pytest.raises(AlreadyExists, match="--force"):
        written(folder)
    assert 'href="./planners/report.html"' in written(folder, force=True)


def test_pictures_beyond_the_bound_are_linked(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert written(folder).count('src="data:image/png;base64,iVBORw=="') == 2
    monkeypatch.setattr(report, "MAX_PICTURE_BYTES", 5)
    page = written(folder, force=True)
    assert page.count("data:image/png") == 1
    assert '<a href="./two-site.png">Alt</a>' in page
